from .files import load_phantom as load_phantom
from .leg_phantom import LegPhantom as LegPhantom
from .leg_phantom import load_leg_phantom as load_leg_phantom
from .meshes import Part as Part
from .meshes import Phantom as Phantom
