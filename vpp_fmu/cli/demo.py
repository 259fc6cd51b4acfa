"""The whole job on the campaign that ships with the project: identify, export, simulate in fmpy, close the loop."""

import time

from tqdm import tqdm

from identification.demo import demo, step_profile
from identification.report import add_identification, key_figures
from vpp_fmu.cli.cosim import STEP_COLUMNS, row, told
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import to_json, to_ssv
from vpp_fmu.record import write_record
from vpp_fmu.report import Page, closed_loop, measured_against_predicted, thinning
from vpp_fmu.response import steps

EXAMPLE = "vpp demo -o demo"


def configure(parser):
    add_output(parser)
    parser.set_defaults(output="demo")


def run(options):
    began = time.perf_counter()
    folder = OutputFolder(options.output)
    with tqdm(total=5, disable=None, leave=False) as bar:

        def stage(name):
            bar.set_description(name)
            bar.update()

        done = demo(folder, stage)
        stage("report")
        found = done.identification
        folder.write("parameters.json", to_json(found.parameters))
        folder.write("parameters.ssv", to_ssv(found.parameters, "parameters"))
        folder.write("identification.json", as_json(found.summary()))
        write_record(folder, "profile.csv", step_profile())
        for name, loop in done.loops.items():
            write_record(folder, f"run_{name.replace(' ', '_')}.csv", loop)
        folder.write("report.html", demo_page(done).html())
    for label, value, note in key_figures(found):
        print(f"{label}: {value} ({note})")
    print(f"exported FMU in fmpy on validation.csv: rmse {done.fmu_rmse:.4f} N, noise floor {found.noise_floor:.4f} N")
    for name, loop in done.loops.items():
        for step in steps(loop):
            print(f"{name}: {told(step)}")
    print(f"{time.perf_counter() - began:.1f} s")
    say_written(folder)


def demo_page(done) -> Page:
    """The report of the whole job."""
    found = done.identification
    validation = found.campaign.validation
    page = Page(
        "From rig data to FMUs",
        "A measured campaign becomes a plant model, the model becomes FMUs, and fmpy runs them: against a record that was not "
        "used to fit, and in a closed loop with the controller's FMU.",
    )
    title = (
        f"The exported FMU, run by fmpy, predicts an unseen record to {done.fmu_rmse:.3f} N; noise is {found.noise_floor:.3f} N"
    )
    figure = measured_against_predicted(
        validation.time, validation["thrust"], {"FMU": done.fmu_thrust}, title, noise=found.noise_floor
    )
    page.section("The plant FMU against measurement")
    page.figure(figure, f"validation.csv. {thinning(len(validation))}")
    page.section("The closed loop of both FMUs")
    found_steps = {name: steps(loop) for name, loop in done.loops.items()}
    down = {name: each[-1].settling for name, each in found_steps.items()}
    title = f"Step down: both actuators settle in {down['dual']:.2f} s, speed alone in {down['speed only']:.2f} s"
    page.figure(closed_loop({name: loop.columns for name, loop in done.loops.items()}, title), "The paper's gains.")
    rows = [(name, *row(step)) for name, each in found_steps.items() for step in each]
    page.table(("loop", *STEP_COLUMNS), rows, "Settled: within 2 % of the step from then on.")
    add_identification(page, found)
    return page
