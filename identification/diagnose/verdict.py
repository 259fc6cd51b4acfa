"""The verdict: attributed, family, partly, unexplained, none; and whether the model that it stands for may ship."""

from collections.abc import Mapping, Sequence

from identification.diagnose.judgement import HALF
from identification.diagnose.lack import Lack
from identification.diagnose.search.fits import Fit


def verdict(base: Fit, final: Fit, before: Lack, after: Lack, family: Mapping[str, Sequence[str]]) -> str:
    """What a search's outcome amounts to, by what the base and the final set lack."""
    if not final.effects:
        return unnamed(before)
    if after.found:
        return "partly" if gone(base, final, before, after) > HALF else "unexplained"
    if after.turns:
        return "partly"
    return "family" if any(family.values()) else "attributed"


def unnamed(lack: Lack) -> str:
    """The verdict on a model to which nothing was added, by what it lacks."""
    return "unexplained" if lack.found or lack.turns else "none"


def gone(base: Fit, final: Fit, before: Lack, after: Lack) -> float:
    """Share of the lack of fit that the set removes: of the pure error's power, else of the log-likelihood there is to gain;
    where it is the speed that lacks something, of what of its error follows the commands, if that is less, and where rest has
    not what passes for noise, of the power of that."""
    fall = 0.5 * (base.deviance - final.deviance)
    if before.bands:
        power = sum(band.power for band in before.bands)
        gone = 1.0 - sum(band.power for band in after.bands) / power if power > 0.0 else 0.0
    else:
        gone = fall / (fall + max(after.score.gain, 0.0)) if fall > 0.0 else 0.0
    if after.lacks_moving:
        gone = min(gone, 1.0 - (after.moving_size / before.moving_size) ** 2) if before.moving_size > 0.0 else 0.0
    if not after.lacks_speed:
        return gone
    was, left = (lack.speed * fit.score.squares["omega"] for fit, lack in ((base, before), (final, after)))
    return min(gone, 1.0 - left / was) if was > 0.0 else 0.0
