"""Predict the open-loop response to the commands of a record."""

from identification.assessment.prediction import predict
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import add_plant, commands_file, read_plant
from vpp_fmu.app.cli.output import add_output, written
from vpp_fmu.app.report.sentences import size
from vpp_fmu.outputs import OutputSet
from vpp_fmu.record import Record, read_record, write_record

EXAMPLE = "vpp simulate campaigns/monday/validation.csv --parameters out/parameters.json -o out"


def configure(parser):
    text = "CSV with time, omega_ref, beta_ref, or the folder of a campaign or a plan"
    parser.add_argument("record", type=commands_file, metavar="RECORD", help=text)
    add_plant(parser, required=True)
    add_output(parser)


def run(options):
    record, parameters = read_record(options.record), read_plant(options)
    folder = OutputSet(options.output, "simulate")
    shown = predict(parameters.model, parameters.values, record)
    columns = {name: record[name] for name in ("time", "omega_ref", "beta_ref")}
    columns |= {"thrust": shown.thrust, "omega": shown.omega, "beta": shown.beta, **shown.further}
    write_record(folder, "prediction.csv", Record(columns, "vpp simulate"))
    measured = "thrust" in record and shown.rmse_thrust is not None
    seconds = float(record.time[-1])
    text = f"Predicted thrust {size(shown.thrust.min())} to {size(shown.thrust.max(), 'N')} over {size(seconds, 's')}"
    text += (
        f", {size(shown.rmse_thrust, 'N')} rms off the reading." if measured else "; the record has no thrust to compare with."
    )
    content = {"format": "vpp-simulation/1", "rows": len(record), "seconds": seconds}
    content |= {"units": {"rmse_thrust": "N", "rmse_omega": "rpm", "fit_thrust": "%"}, "rmse_omega": shown.rmse_omega}
    content |= {name: getattr(shown, name) if measured else None for name in ("rmse_thrust", "fit_thrust")}
    return Answer(text, content, written=written(options, folder, parameters))
