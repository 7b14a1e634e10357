"""`python -m adaptdrive.cli`."""

import sys

from adaptdrive.cli import main

sys.exit(main())
