"""python -m tests.studies measured DATA [--diagnose]: campaigns and stand logs in a folder, by error on what no fit has seen.

DATA holds campaign folders, and in `sar_motor` two logs of a thrust stand. A campaign is identified, exported, and its FMU run
by fmpy on validation.csv; of the logs one day is fitted and the other predicted, with the first day's speed map.
"""

import argparse
import tempfile
from pathlib import Path

from identification.diagnose.diagnose import diagnose
from identification.diagnose.report.summary import artefact
from identification.identify import identify
from identification.stand.rcbenchmark import read_log
from identification.stand.speed_map import fit_speed_map
from identification.worth.quality import noise_floor, rmse
from vpp_fmu.campaign import NAMES, Campaign, read_campaign
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.rig import infer_rig


def main(arguments):
    parser = argparse.ArgumentParser(prog="python -m tests.studies measured", description=__doc__)
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--diagnose", action="store_true", help="also what the model lacks, and the error with it")
    options = parser.parse_args(arguments)
    for folder in sorted(options.data.iterdir()):
        if any(f.name.partition(".")[0] in NAMES for f in folder.glob("*.csv*")):
            of_campaign(read_campaign(folder), options.diagnose)
    logs = sorted((options.data / "sar_motor").glob("TimeConstant_Test_*.csv"))
    for fitted, other in (logs, logs[::-1]) if len(logs) == 2 else ():
        of_days(fitted, other, options.diagnose)


def of_campaign(campaign, look):
    found, name = identify(campaign), campaign.folder.name
    twice = campaign.open_loop is not None and campaign.repeat is not None
    floor = f"{noise_floor(campaign.open_loop, campaign.repeat):.4g} N" if twice else "not measured"
    told = f"{name}: noise floor {floor}"
    if campaign.validation is not None:
        told += f"; rmse on validation.csv {in_fmpy(found.parameters, campaign):.4g} N through the FMU in fmpy"
        told += f", fit {found.predictions['validation'].fit_thrust:.1f} %"
        told += f", {100 * found.coverage['validation']:.1f} % of the readings in the 95 % band"
    print(told, flush=True)
    if look:
        seen = diagnose(campaign)
        if campaign.validation is not None:
            before, after = (in_fmpy(seen.parameters(fit), campaign) for fit in (seen.base, seen.final))
        else:
            before, after = (seen.errors(fit)[0] for fit in (seen.base, seen.final))
        _say(name, seen, before, after, "on validation.csv" if campaign.validation is not None else "cross-validated")


def _say(name, seen, before, after, where):
    effects = ", ".join(seen.final.effects) or "no effect"
    refuted = f" (refuted: {', '.join(seen.selection.final.effects)}: {seen.refuted})" if seen.refuted else ""
    print(f"{name}: {seen.verdict}: {effects}{refuted}; {where} {before:.4g} N before, {after:.4g} N after", flush=True)
    for effect, judged in seen.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.4g}" for channel, gain in judged.gain.items())
        told = artefact(seen, effect)
        print(
            f"  {effect}: evidence {judged.evidence:.4g} nats; cross-validated {gains}" + f"; {told}" * bool(told), flush=True
        )


def in_fmpy(parameters, campaign):
    """Thrust error (N) on the validation record of the exported FMU, run by fmpy."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "VppPlant.fmu")
        path.write_bytes(python_fmu(parameters.model, parameters.values))
        return rmse(simulate_in_fmpy(path, campaign.validation) - campaign.validation["thrust"])


def of_days(fitted, other, look):
    """One day's log fitted, the other predicted as it stands."""
    first, second = read_log(str(fitted)), read_log(str(other))
    speed_map = fit_speed_map(first.steady_points(), first.span, first.loaded_voltage, fitted.name)
    records = []
    for log in (first, second):
        tare = log.tare()
        records.append(log.record(speed_map.omega_ref(log.signal), tare[0] if tare else 0.0, False))
    rig = infer_rig(records[:1], None, {})
    campaign = Campaign(Path(fitted.stem), None, (), records[0], None, records[1], rig=rig)
    found = identify(campaign)
    day, own = found.predictions["validation"], found.predictions["open_loop"]
    print(
        f"{fitted.stem} fitted: {own.rmse_thrust:.3f} N, fit {own.fit_thrust:.1f} %; "
        f"{other.stem} as it stands: {day.rmse_thrust:.3f} N, fit {day.fit_thrust:.1f} %, "
        f"held: {', '.join(found.refinement.held)}",
        flush=True,
    )
    if look:
        seen = diagnose(campaign)
        before, after = (seen.errors(fit)[0] for fit in (seen.base, seen.final))
        _say(fitted.stem, seen, before, after, "other day")
