"""The roles of records, distinguished by type: fitted records, and the hold-out record that is used only once."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record


@dataclass(frozen=True, eq=False)
class Fitted:
    """A record that passed the gate, and may be used for fits and for the selection of models."""

    name: str
    record: Record


@dataclass(frozen=True, eq=False)
class Unseen:
    """A hold-out record: neither fits nor selection use it; it is used once, when the model is final."""

    name: str
    record: Record


def roles(campaign: Campaign, more: Mapping[str, Record]) -> tuple[list[list[Fitted]], Unseen | None]:
    """(fitted records, those of the same commands together; the unseen one) of a campaign that passed the gate.

    A validation record is fitted if there is no other record. BadInput without any.
    """
    own = {"open_loop": campaign.open_loop, "repeat": campaign.repeat}
    fitted = {name: record for name, record in own.items() if record is not None} | dict(more)
    unseen = campaign.validation
    if not fitted and unseen is not None:
        fitted, unseen = {"validation": unseen}, None
    if not fitted:
        raise BadInput(campaign.folder, "open_loop.csv", "no such file", "a record with time, omega_ref, beta_ref, thrust")
    groups = together([Fitted(name, record) for name, record in fitted.items()])
    return groups, None if unseen is None else Unseen("validation", unseen)


def together(records: Iterable[Fitted]) -> list[list[Fitted]]:
    """Records of the same commands together, in their order."""
    groups: list[list[Fitted]] = []
    for one in records:
        same = next((g for g in groups if _same_commands(g[0].record, one.record)), None)
        if same is None:
            groups.append([one])
        else:
            same.append(one)
    return groups


def _same_commands(a: Record, b: Record) -> bool:
    if len(a) != len(b) or not np.array_equal(a.steps, b.steps):
        return False
    measured = {"thrust", "omega", "beta", "current", "torque", "power"}
    names = [n for n in {*a.columns, *b.columns} - measured if n in a and n in b and a[n].dtype.kind == "f"]
    return all(np.array_equal(a[n], b[n]) for n in names)
