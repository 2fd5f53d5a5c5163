from .pipeline import RunResult as RunResult
from .pipeline import run_scan as run_scan
