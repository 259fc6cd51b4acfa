"""How much a search tries: thoroughly or not, and within a time budget."""

import time
from collections.abc import Callable


class Effort:
    """`budget` [s]: time after which no further step begins; None: unlimited. `thorough`: terms of unknown form are
    learned if lack of fit remains, and compared with the named effects. `stage`: called with the name of each stage.
    `progress`: called within a search with the numbers of finished and of all candidates, and the name of the best so far.

    `not_tried`: steps that did not begin, because the budget was used up.
    """

    def __init__(
        self,
        budget: float | None = None,
        thorough: bool = True,
        stage: Callable[[str], None] = lambda text: None,
        progress: Callable[[int, int, str], None] = lambda done, total, best: None,
    ):
        self.budget, self.thorough, self.stage, self.progress = budget, thorough, stage, progress
        self.not_tried: list[str] = []
        self._began = time.monotonic()

    def allows(self, step: str) -> bool:
        """Whether a step may begin. If not, it is one of those `not_tried`."""
        if self.budget is None or time.monotonic() - self._began < self.budget:
            return True
        if step not in self.not_tried:
            self.not_tried.append(step)
        return False
