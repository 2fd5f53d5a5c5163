from .noise import ImuNoise as ImuNoise
from .noise import add_noise as add_noise
from .sensors import Sensor as Sensor
from .signals import ImuSignals as ImuSignals
from .signals import SensorStart as SensorStart
from .skin_mount import SkinMount as SkinMount
from .strapdown import integrate as integrate
from .vibration import Vibration as Vibration
