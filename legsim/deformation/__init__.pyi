from .files import load_motion as load_motion
from .files import save_motion as save_motion
from .models import ControlPointMotion as ControlPointMotion
from .models import FieldMotion as FieldMotion
from .models import Motion as Motion
from .models import RigidMotion as RigidMotion
from .polyrigid import PolyrigidMotion as PolyrigidMotion
