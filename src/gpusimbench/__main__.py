"""python -m gpusimbench: the command gsb."""

import sys

from gpusimbench.cli import main

sys.exit(main())
