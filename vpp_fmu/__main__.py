import sys

from vpp_fmu.app.cli import main

sys.exit(main())
