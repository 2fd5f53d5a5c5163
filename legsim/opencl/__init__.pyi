from .device import Device as Device
from .device import open_device as open_device
from .discovery import Candidate as Candidate
from .discovery import candidates as candidates
