# What a type checker and an editor see of the names that __init__.py imports when they are used.
from vpp_fmu.app.api.check import check as check
from vpp_fmu.app.api.control import allocate as allocate
from vpp_fmu.app.api.control import learn as learn
from vpp_fmu.app.api.control import tune as tune
from vpp_fmu.app.api.diagnose import diagnose as diagnose
from vpp_fmu.app.api.export import export_fmu as export_fmu
from vpp_fmu.app.api.identify import identify as identify
from vpp_fmu.app.api.loop import run_loop as run_loop
from vpp_fmu.app.api.loop import simulate as simulate
from vpp_fmu.app.api.objects import example_campaign as example_campaign
from vpp_fmu.app.api.objects import read_campaign as read_campaign
from vpp_fmu.app.api.objects import read_parameters as read_parameters
from vpp_fmu.app.api.objects import read_record as read_record
from vpp_fmu.app.api.plan import plan as plan
from vpp_fmu.app.report.result import write_report as write_report
from vpp_fmu.campaign import Campaign as Campaign
from vpp_fmu.errors import BadInput as BadInput
from vpp_fmu.errors import VppError as VppError
from vpp_fmu.kernel.slave import Slave as Slave
from vpp_fmu.kernel.types import Effect as Effect
from vpp_fmu.kernel.types import Model as Model
from vpp_fmu.kernel.types import Parameter as Parameter
from vpp_fmu.kernel.types import Signal as Signal
from vpp_fmu.kernel.types import State as State
from vpp_fmu.kernel.types import instance as instance
from vpp_fmu.parameters import ParameterSet as ParameterSet
from vpp_fmu.record import Record as Record
from vpp_fmu.rig import Rig as Rig

__all__: list[str]
__version__: str
