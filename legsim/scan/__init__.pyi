from .acquisition import Imaging as Imaging
from .detector import Detector as Detector
from .projector import project as project
from .spectrum import Spectrum as Spectrum
