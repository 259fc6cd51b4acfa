"""The identified rig as Gymnasium environments, single and vectorised.

Importing this package registers `VppThrust-v0`. ExtraMissing without gymnasium.
"""

from vpp_fmu.errors import ExtraMissing

try:
    import gymnasium
except ImportError as error:
    raise ExtraMissing("gymnasium: found no library, expected one. Try: pip install 'vpp-fmu[gym]'") from error

from vpp_fmu.gym.envs import VppThrustEnv, VppThrustVectorEnv
from vpp_fmu.gym.reward import Moment, Reward
from vpp_fmu.gym.task import Task

__all__ = ["Moment", "Reward", "Task", "VppThrustEnv", "VppThrustVectorEnv"]

NAME, ENTRY = "VppThrust-v0", "vpp_fmu.gym.envs:VppThrust"

if NAME not in gymnasium.registry:
    gymnasium.register(NAME, entry_point=f"{ENTRY}Env", vector_entry_point=f"{ENTRY}VectorEnv")
