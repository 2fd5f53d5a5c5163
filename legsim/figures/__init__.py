"""Figures for reports: dark text on white, units on every axis, made without a screen and without pyplot's global state."""

from legsim.figures.canvas import Figure as Figure
from legsim.figures.canvas import png as png
from legsim.figures.curves import imu_curves as imu_curves
from legsim.figures.curves import joint_angles as joint_angles
from legsim.figures.curves import marker_residuals as marker_residuals
from legsim.figures.curves import motion_errors as motion_errors
from legsim.figures.curves import sway as sway
from legsim.figures.pictures import overlay as overlay
from legsim.figures.pictures import projection_montage as projection_montage
from legsim.figures.pictures import slices as slices
from legsim.figures.statistics import BoxGroup as BoxGroup
from legsim.figures.statistics import HeatMap as HeatMap
from legsim.figures.statistics import box_plots as box_plots
from legsim.figures.statistics import heat_maps as heat_maps
from legsim.figures.still import still as still
