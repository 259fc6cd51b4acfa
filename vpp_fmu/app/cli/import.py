"""Convert a log to a file of a campaign: any table, or the log of an RCbenchmark stand.

The mapping of columns, and all corrections and omissions, are printed and saved in the folder beside the record."""

import importlib

EXAMPLE = "vpp import csv flight.csv --map time=t:ms omega_ref=cmd:rpm thrust=Fz:gf -o mine --as open_loop\n  vpp check mine"

FORMATS = {
    "csv": "any table: CSV and its kin, Parquet, MAT, HDF5",
    "rcbenchmark": "the log of an RCbenchmark (Tyto) thrust stand",
}


def configure(parser):
    parts = parser.add_subparsers(dest="format", required=True, metavar="FORMAT", parser_class=type(parser))
    for name, text in FORMATS.items():
        module = importlib.import_module(f"vpp_fmu.app.cli.import_{name}")
        own = parts.add_parser(name, help=text, description=module.__doc__, formatter_class=parser.formatter_class)
        own.epilog = f"example:\n  {module.EXAMPLE}"
        module.configure(own)
        own.set_defaults(run=module.run)


def run(options):
    return options.run(options)
