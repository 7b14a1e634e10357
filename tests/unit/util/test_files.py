"""Files that are replaced whole."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from adaptdrive.util.files import replace_result


def test_commands_that_make_one_file_at_once_all_succeed(tmp_path: Path) -> None:
    figure = tmp_path / "figure.png"
    contents = {bytes([number]) * 100_000 for number in range(4)}
    with ThreadPoolExecutor(max_workers=4) as commands:
        for _ in range(20):
            list(commands.map(lambda content: replace_result(figure, content), contents))
            assert figure.read_bytes() in contents
    assert [path.name for path in tmp_path.iterdir()] == ["figure.png"]
