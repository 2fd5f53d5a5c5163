from .fdk import FdkOptions as FdkOptions
