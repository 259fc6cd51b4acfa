"""python -m tests.studies measured DATA [--diagnose]: campaigns and stand logs in a folder, by error on what no fit has seen.

DATA holds campaign folders, and in `sar_motor` two logs of a thrust stand. A campaign is identified, exported, and its FMU run
by fmpy on validation.csv; of the logs one day is fitted and the other predicted, with the first day's speed map.
"""

import argparse
import tempfile
from pathlib import Path

from identification.diagnose.diagnose import diagnose
from identification.identify import identify
from identification.stand.rcbenchmark import read_log
from identification.stand.speed_map import fit_speed_map
from identification.worth.quality import noise_floor, rmse
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import simulate_in_fmpy


def main(arguments):
    parser = argparse.ArgumentParser(prog="python -m tests.studies measured", description=__doc__)
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--diagnose", action="store_true", help="also what the model lacks, and the error with it")
    options = parser.parse_args(arguments)
    for folder in sorted(options.data.iterdir()):
        if (folder / "validation.csv").exists():
            of_campaign(read_campaign(folder), options.diagnose)
    logs = sorted((options.data / "sar_motor").glob("TimeConstant_Test_*.csv"))
    for fitted, other in (logs, logs[::-1]) if len(logs) == 2 else ():
        of_days(fitted, other, options.diagnose)


def of_campaign(campaign, look):
    floor = noise_floor(campaign.open_loop, campaign.repeat)
    found = identify(campaign)
    error = in_fmpy(found.parameters, campaign)
    print(
        f"{campaign.folder.name}: rmse on validation.csv {error:.4f} N through the FMU in fmpy, noise floor {floor:.4f} N; "
        f"fit {found.predictions['validation'].fit_thrust:.1f} %, "
        f"{100 * found.coverage['validation']:.1f} % of the readings in the 95 % band",
        flush=True,
    )
    if look:
        seen = diagnose(campaign)
        before, after = (in_fmpy(seen.parameters(fit), campaign) for fit in (seen.base, seen.final))
        effects = ", ".join(seen.final.effects) or "no effect"
        print(f"{campaign.folder.name}: {seen.verdict}: {effects}; {before:.4f} N before, {after:.4f} N after", flush=True)


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
    campaign = Campaign(Path(fitted.stem), None, (), records[0], None, records[1])
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
        effects = ", ".join(seen.final.effects) or "no effect"
        before, after = seen.held_before.rmse_thrust, seen.held_after.rmse_thrust
        print(f"{fitted.stem}: {seen.verdict}: {effects}; other day {before:.3f} N before, {after:.3f} N after", flush=True)
        for judged in seen.selection.judgements.values():
            gains = ", ".join(f"{channel} {gain:+.0f}" for channel, gain in judged.held_out_gain.items())
            worth = f"BIC falls by {judged.delta_bic:.0f} on its day, log-likelihood of the other day: {gains}"
            print(f"  {judged.effect}: {worth}" + f"; {judged.artefact}" * bool(judged.artefact), flush=True)
