from .regions import Region as Region
from .scores import MethodResult as MethodResult
from .similarity import evaluate as evaluate
