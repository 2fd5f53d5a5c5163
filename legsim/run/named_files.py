"""The files that the settings of a run name, as parts of keys: their content decides results."""

from legsim.config import RunConfig
from legsim.phantom import imaged_leg
from legsim.run import c_arm, sensors
from legsim.run import motion as run_motion


def fingerprint(settings: RunConfig) -> tuple[object, ...]:
    """Content of every file that settings name, but of the user's own methods.

    Those have keys of their own (:func:`legsim.run.methods.fingerprint`). Places of all names are
    in :data:`legsim.config.FILES`.

    Raises:
        LegsimError: a file that is not there or cannot be used.
    """
    return (
        run_motion.fingerprint(settings.motion),
        of_scan(settings),
        sensors.fingerprint(settings.imu),
    )


def of_scan(settings: RunConfig) -> tuple[object, ...]:
    """Content of the files that decide the projections besides the recording.

    Raises:
        LegsimError: a file that is not there or cannot be used.
    """
    phantom = settings.phantom.file
    return (
        c_arm.fingerprint(settings.scan, settings.seed),
        imaged_leg.content_key(phantom) if phantom else None,
    )
