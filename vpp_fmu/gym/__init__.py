"""The identified rig as Gymnasium environments: `VppThrust-v0`, single and vectorised, and any plant FMU as `VppFmuEnv`.

Importing this package registers `VppThrust-v0`. ExtraMissing without gymnasium.
"""

from vpp_fmu.errors import ExtraMissing

try:
    import gymnasium
except ImportError as error:
    raise ExtraMissing("gymnasium: found no library, expected one. Try: pip install 'vpp-fmu[gym]'") from error

from vpp_fmu.gym.envs import VppFmuEnv, VppThrustEnv, VppThrustVectorEnv
from vpp_fmu.gym.reward import Moment, Reward
from vpp_fmu.gym.task import Task

__all__ = ["Moment", "Reward", "Task", "VppFmuEnv", "VppThrustEnv", "VppThrustVectorEnv"]

NAME = "VppThrust-v0"

if NAME not in gymnasium.registry:
    gymnasium.register(
        NAME, entry_point="vpp_fmu.gym.envs:VppThrustEnv", vector_entry_point="vpp_fmu.gym.envs:VppThrustVectorEnv"
    )
