"""The date in results."""

import os
from datetime import datetime, timezone

from vpp_fmu.errors import BadInput

EPOCH = "SOURCE_DATE_EPOCH"
"""Environment variable that sets the date, in s since 1970, so that two runs give the same bytes (reproducible-builds.org)."""


def now() -> str:
    """ISO 8601, UTC, to the second."""
    wanted = os.environ.get(EPOCH)
    try:
        now = datetime.now(timezone.utc) if wanted is None else datetime.fromtimestamp(int(wanted), timezone.utc)
    except (ValueError, OverflowError, OSError) as error:
        raise BadInput("environment", EPOCH, repr(wanted), "whole seconds since 1970") from error
    return now.replace(microsecond=0).isoformat()
