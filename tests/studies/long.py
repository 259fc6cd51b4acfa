"""python -m tests.studies long: seconds and memory of a diagnosis of a record of 600 s, beside those of 90 s.

Aims: seconds grow no faster than the readings, and no more than 300 MB.
"""

from itertools import pairwise

from .cases import WHOLE, draw
from .diagnosis import outcome
from .own_process import Failed, apart

MB = 300.0


def main(parser, arguments):
    parser.add_argument("--seconds", type=float, nargs="+", default=[90.0, 600.0], metavar="S", help="of the records")
    parser.add_argument("--hidden", default="pitch_command_deadband", metavar="NAME", help="effect (default: %(default)s)")
    parser.add_argument("--size", default="paper", help="of the rig (default: %(default)s)")
    parser.add_argument("--rate", type=int, default=250, metavar="HZ", help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="fits side by side (default: %(default)s)")
    parser.add_argument("--limit", type=float, default=3600.0, metavar="S", help="seconds for one (default: %(default)g)")
    options = parser.parse_args(arguments)
    like = {"size": options.size, "rate": options.rate, "noise": "AR", "level": 1.0, "strength": 1.0} | WHOLE
    print(__doc__.split("\n\n")[1])
    print(f"{options.hidden} on a {options.size} rig, {options.rate} Hz, full size, open loop and repeat\n")
    print(f"{'record':>8} {'readings':>9} {'verdict':>12} {'effects':32} {'seconds':>8} {'CPU s':>6} {'MB':>6}")
    costs = []
    for seconds in options.seconds:
        case = draw(options.seed, "single", hidden=(options.hidden,), seconds=seconds, **like)
        try:
            c = apart(outcome, case, options.threads, limit=options.limit)
        except Failed as failed:
            print(f"{seconds:6.0f} s  {failed}", flush=True)
            continue
        result = f"{c['verdict']:>12} {'+'.join(c['effects']):32} {c['seconds']:8.1f} {c['cpu']:6.1f} {c['mb']:6.0f}"
        print(f"{seconds:6.0f} s {c['readings']:9} {result}", flush=True)
        costs.append(c)
    for a, b in pairwise(costs):
        more, seconds, cpu, mb = (b[n] / a[n] for n in ("readings", "seconds", "cpu", "mb"))
        print(f"{more:.1f} times the readings: {seconds:.1f} times the seconds ({cpu:.1f} of CPU), {mb:.1f} times the memory")
    if costs:
        most = max(c["mb"] for c in costs)
        print(f"at most {most:.0f} MB (aim {MB:.0f}): {'reached' if most <= MB else 'not reached'}")
