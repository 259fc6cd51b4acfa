"""The report of a learned law: its search, and the comparison with the tuned PID on held-out plants."""

from typing import Any

import numpy as np

from identification.tune.learn import LearnedLaw
from vpp_fmu.app.report.figures import closed_loop
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.app.report.sentences import change
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import POLICY
from vpp_fmu.policy import Policy
from vpp_fmu.structured import as_json

NAMES = {"policy": "learned law", "PID": "tuned PID"}


class LearnResult(Result):
    """A learned control law beside the tuned PID. `found`: the search, and the comparison on held-out plants."""

    verb = "learn"
    writes = ("learning.json", "report.html")
    title = "A learned control law"
    found: LearnedLaw

    @property
    def policy(self) -> Policy:
        """The law, for export_fmu."""
        return self.found.policy

    def headline(self) -> str:
        found = self.found
        policy, pid = (float(np.mean(found.flights[name].errors)) for name in ("policy", "PID"))
        word = "less" if policy < pid else "more"
        return (
            f"The learned law has {100.0 * abs(policy / pid - 1.0):.0f} % {word} squared error than the tuned PID: "
            f"{change(pid, policy, 's')}, mean of {len(found.flights['PID'].errors)} held-out plants."
        )

    def key_figures(self) -> list[tuple[str, str, str]]:
        found = self.found
        policy, pid = found.flights["policy"], found.flights["PID"]
        more, count = np.mean(policy.errors) / np.mean(pid.errors) - 1.0, len(policy.errors)
        worst = number(float(np.max(pid.errors)), 3), number(float(np.max(policy.errors)), 3)
        return [
            ("squared error", f"{100.0 * more:+.0f} %", f"mean of {count} held-out plants, tuned PID → learned law"),
            ("less error", f"{100.0 * found.better:.0f} %", "share of the held-out plants"),
            ("worst plant", f"{worst[0]} → {worst[1]} s", "integral of the squared normalised error, PID → law"),
            ("commands", f"{pid.travel:.3g} → {policy.travel:.3g} 1/s", "ranges that the commands travel a second, PID → law"),
            ("fallback", f"{100.0 * found.fallback:.2g} %", "share of time in which the PID acts in the law's place"),
            ("search", f"{found.evaluations[-1]}", f"evaluations in {found.seconds:.0f} s, with the comparison"),
        ]

    def to_dict(self) -> dict[str, Any]:
        found = self.found
        compared = {
            name: {
                "squared_error_mean": float(np.mean(f.errors)),
                "squared_error_worst": float(np.max(f.errors)),
                "overshoot_median": float(np.median(f.overshoots)),
                "travel_per_second": f.travel,
            }
            for name, f in found.flights.items()
        }
        return {
            "format": "vpp-learning/1",
            "units": {"squared_error": "s", "overshoot": "share of a step", "travel": "ranges of the commands"},
            "network": list(found.policy.size),
            "held_out_plants": len(found.flights["policy"].errors),
            "held_out": compared,
            "share_of_plants_with_less_error": found.better,
            "share_of_time_in_fallback": found.fallback,
            "generations": len(found.cost),
            "evaluations": int(found.evaluations[-1]),
            "seconds": found.seconds,
        }

    def write(self, folder: OutputFolder) -> None:
        found = self.found
        folder.write(POLICY, as_json(found.policy.to_dict()))
        rows = [f"{n},{c:.7g}" for n, c in zip(found.evaluations, found.cost, strict=True)]
        folder.write("learning_curve.csv", "\n".join(["evaluations,cost", *rows]) + "\n")
        super().write(folder)

    def fill(self, page: Page) -> None:
        found = self.found
        size = " x ".join(map(str, found.policy.size))
        text = f"A network of {size} units in the controller's place. Its weights were searched on plants drawn from the "
        text += "uncertainty of the parameters. The PID was tuned on set-points of the same kind, unless gains were given. The "
        text += "comparison flies plants, set-points and noise that are not part of the search."
        page.section("The comparison", text)
        runs = {NAMES[name]: run for name, run in found.example.items()}
        title = "A flight of the identified plant with held-out set-points"
        page.figure(closed_loop(runs, title), "Thrust is the plant's, not its reading.")
