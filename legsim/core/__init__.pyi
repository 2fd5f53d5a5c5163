from .errors import LegsimError as LegsimError
from .errors import file_error as file_error
from .progress import OnProgress as OnProgress
from .values import Float32Array as Float32Array
from .values import FloatArray as FloatArray
