from .page import ReportContent as ReportContent
from .page import render as render
