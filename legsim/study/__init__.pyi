from .config import StudyConfig as StudyConfig
from .results import StudyResults as StudyResults
