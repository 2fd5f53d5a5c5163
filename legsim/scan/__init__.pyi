from .acquisition import Imaging as Imaging
from .c_arm import CArm as CArm
from .detector import Detector as Detector
from .projector import project as project
from .spectrum import Spectrum as Spectrum
