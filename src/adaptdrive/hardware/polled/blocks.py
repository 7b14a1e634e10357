"""Few requests for many registers: reads run across small gaps, writes never do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from adaptdrive.config.modbus import Register

Table = Literal["input", "holding", "coil", "discrete"]


@dataclass(frozen=True, slots=True)
class Block:
    """Neighbouring registers, asked for or written at once.

    Attributes:
        table: Kind of registers.
        address: First address, zero-based.
        count: Number of registers.
        single: Whether it is written alone: function 5 for a coil, 6 for a register.
    """

    table: Table
    address: int
    count: int
    single: bool = False

    @property
    def end(self) -> int:
        """Address behind the block."""
        return self.address + self.count

    def __str__(self) -> str:
        last = f"…{self.end - 1}" if self.count > 1 else ""
        return f"{self.table} {self.address}{last} (address from 0)"

    def holds(self, register: Register) -> bool:
        """Return whether a register lies in this block."""
        inside = self.address <= register.address and register.end <= self.end
        return register.table == self.table and inside


def plan_blocks(
    registers: Iterable[Register], max_gap: int, max_count: int, *, write: bool = False
) -> tuple[Block, ...]:
    """Cover registers with blocks.

    Args:
        registers: What is wanted; registers may share addresses.
        max_gap: Unwanted registers that a block may run across.
        max_count: Longest block; no value is ever cut in two.
        write: Whether they are written: each coil alone.
    """
    blocks: list[Block] = []
    for register in sorted(registers, key=lambda one: (one.table, one.address, one.end)):
        last = blocks[-1] if blocks else None
        single = write and (register.table == "coil" or max_count == 1)
        longest = 1 if single else max_count
        if last is not None and _reaches(last, register, max_gap, longest):
            end = max(last.end, register.end)
            blocks[-1] = Block(last.table, last.address, end - last.address, last.single)
        else:
            blocks.append(Block(register.table, register.address, register.words, single))
    return tuple(blocks)


def _reaches(block: Block, register: Register, max_gap: int, max_count: int) -> bool:
    near = register.address - block.end <= max_gap
    short = max(block.end, register.end) - block.address <= max_count
    return block.table == register.table and near and short
