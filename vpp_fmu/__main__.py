import sys

from vpp_fmu.cli import main

sys.exit(main())
