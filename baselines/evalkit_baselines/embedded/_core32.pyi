"""The embedded core in single precision: as ``_core64``, with float32."""

from evalkit_baselines.embedded._core64 import REAL as REAL
from evalkit_baselines.embedded._core64 import Grid as Grid
from evalkit_baselines.embedded._core64 import Icp as Icp
from evalkit_baselines.embedded._core64 import Index as Index
from evalkit_baselines.embedded._core64 import Pipeline as Pipeline
from evalkit_baselines.embedded._core64 import Slam as Slam
from evalkit_baselines.embedded._core64 import defaults as defaults
from evalkit_baselines.embedded._core64 import normals as normals
from evalkit_baselines.embedded._core64 import optimise_graph as optimise_graph
