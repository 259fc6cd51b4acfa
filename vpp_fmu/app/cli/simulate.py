"""Predict the open-loop response to the commands of a record."""

from identification.assessment.prediction import predict
from vpp_fmu.app.cli.output import add_effects_from, add_output, say_written
from vpp_fmu.digits import number
from vpp_fmu.kernel.plant import plant
from vpp_fmu.outputs import OutputSet
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import parameters_file, read_parameters
from vpp_fmu.record import Record, read_record, write_record

EXAMPLE = "vpp simulate campaigns/monday/validation.csv --parameters out/parameters.json -o out"


def configure(parser):
    parser.add_argument("record", metavar="RECORD", help="CSV with time, omega_ref, beta_ref")
    text = "the plant's parameters, a file or its folder"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", required=True, help=text)
    add_effects_from(parser)
    add_output(parser)


def run(options):
    record, library = read_record(options.record), library_with(options.effects_from)
    parameters = read_parameters(options.parameters, lambda names: plant(names, library))
    folder = OutputSet(options.output, "simulate")
    shown = predict(parameters.model, parameters.values, record)
    columns = {name: record[name] for name in ("time", "omega_ref", "beta_ref")}
    columns |= {"thrust": shown.thrust, "omega": shown.omega, "beta": shown.beta, **shown.further}
    write_record(folder, "prediction.csv", Record(columns, "vpp simulate"))
    measured = "thrust" in record and shown.rmse_thrust is not None
    lines = [f"thrust: rmse {number(shown.rmse_thrust)} N against {options.record}"] if measured else []
    say_written(folder, parameters, lines)
