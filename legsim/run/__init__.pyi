from .pipeline import RunResult as RunResult
