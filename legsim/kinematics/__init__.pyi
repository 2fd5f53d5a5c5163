from .from_recording import solve_kinematics as solve_kinematics
from .joint_splines import JointSplines as JointSplines
from .leg_model import LegModel as LegModel
from .moving_leg import MovingLeg as MovingLeg
from .skeleton import JointCenters as JointCenters
from .skeleton import SegmentPoses as SegmentPoses
from .skeleton import SegmentScales as SegmentScales
