"""`python -m adaptdrive.analysis SESSION`: its figure and report, next to its files."""

import sys
from pathlib import Path

from adaptdrive.analysis.figure import plot

plot(Path(sys.argv[1]))
