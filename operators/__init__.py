"""What is done to streams."""

from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from operators.align import Align
    from operators.arithmetic import Arithmetic
    from operators.channels import Select
    from operators.decimate import Decimate
    from operators.depth.activity import Activity
    from operators.depth.bed import BedRegion
    from operators.depth.breathing import Breathing
    from operators.depth.motion import Motion
    from operators.depth.night_map import NightMap
    from operators.depth.presence import Presence
    from operators.depth.region import RegionDepth
    from operators.depth.simplify import Simplify
    from operators.depth.view import View
    from operators.derivative import Derivative
    from operators.emg import Envelope
    from operators.emg.electrode_watch import ElectrodeWatch
    from operators.emg.normalise import Normalise
    from operators.emg.quality import SignalQuality
    from operators.extremes import MovingMax, MovingMin
    from operators.features.bundle import Bundle
    from operators.features.mirror import Mirror
    from operators.features.pose import Pose
    from operators.features.rest import SkipRest
    from operators.features.stack import Stack
    from operators.features.standardise import Standardise
    from operators.gait.acceleration import AccelerationContacts
    from operators.gait.cycle_watch import CycleWatch
    from operators.gait.cycles import Cycles
    from operators.gait.ensemble import CycleEnsemble
    from operators.gait.force import ForceContacts, SwitchContacts
    from operators.gait.inertial import InertialContacts
    from operators.gait.marker import MarkerContacts
    from operators.gait.review import CycleReview
    from operators.gait.statistics import CycleStatistics
    from operators.gaps import FillGaps
    from operators.iir import Bandpass, Highpass, Lowpass, Notch
    from operators.mean import RemoveMean
    from operators.moving import MovingMean, MovingRms
    from operators.neighbours import Neighbours
    from operators.pause import Pause
    from operators.rectify import Rectify
    from operators.resample import Resample
    from operators.scale import Scale
    from operators.segmentation import Segment
    from operators.sleep.epochs import Epochs
    from operators.sleep.nights import Nights
    from operators.sleep.periods import SleepPeriods
    from operators.sleep.scorer import SleepScorer
    from operators.sleep.statistics import SleepStatistics
    from operators.smooth import Binomial
    from operators.threshold import Threshold

__all__ = [
    "AccelerationContacts",
    "Activity",
    "Align",
    "Arithmetic",
    "Bandpass",
    "BedRegion",
    "Binomial",
    "Breathing",
    "Bundle",
    "CycleEnsemble",
    "CycleReview",
    "CycleStatistics",
    "CycleWatch",
    "Cycles",
    "Decimate",
    "Derivative",
    "ElectrodeWatch",
    "Envelope",
    "Epochs",
    "FillGaps",
    "ForceContacts",
    "Highpass",
    "InertialContacts",
    "Lowpass",
    "MarkerContacts",
    "Mirror",
    "Motion",
    "MovingMax",
    "MovingMean",
    "MovingMin",
    "MovingRms",
    "Neighbours",
    "NightMap",
    "Nights",
    "Normalise",
    "Notch",
    "Pause",
    "Pose",
    "Presence",
    "Rectify",
    "RegionDepth",
    "RemoveMean",
    "Resample",
    "Scale",
    "Segment",
    "Select",
    "SignalQuality",
    "Simplify",
    "SkipRest",
    "SleepPeriods",
    "SleepScorer",
    "SleepStatistics",
    "Stack",
    "Standardise",
    "SwitchContacts",
    "Threshold",
    "View",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "AccelerationContacts": "operators.gait.acceleration",
        "Activity": "operators.depth.activity",
        "Align": "operators.align",
        "Arithmetic": "operators.arithmetic",
        "Bandpass": "operators.iir",
        "BedRegion": "operators.depth.bed",
        "Binomial": "operators.smooth",
        "Breathing": "operators.depth.breathing",
        "Bundle": "operators.features.bundle",
        "CycleEnsemble": "operators.gait.ensemble",
        "CycleReview": "operators.gait.review",
        "CycleStatistics": "operators.gait.statistics",
        "CycleWatch": "operators.gait.cycle_watch",
        "Cycles": "operators.gait.cycles",
        "Decimate": "operators.decimate",
        "Derivative": "operators.derivative",
        "ElectrodeWatch": "operators.emg.electrode_watch",
        "Envelope": "operators.emg",
        "Epochs": "operators.sleep.epochs",
        "FillGaps": "operators.gaps",
        "ForceContacts": "operators.gait.force",
        "Highpass": "operators.iir",
        "InertialContacts": "operators.gait.inertial",
        "Lowpass": "operators.iir",
        "MarkerContacts": "operators.gait.marker",
        "Mirror": "operators.features.mirror",
        "Motion": "operators.depth.motion",
        "MovingMax": "operators.extremes",
        "MovingMean": "operators.moving",
        "MovingMin": "operators.extremes",
        "MovingRms": "operators.moving",
        "Neighbours": "operators.neighbours",
        "NightMap": "operators.depth.night_map",
        "Nights": "operators.sleep.nights",
        "Normalise": "operators.emg.normalise",
        "Notch": "operators.iir",
        "Pause": "operators.pause",
        "Pose": "operators.features.pose",
        "Presence": "operators.depth.presence",
        "Rectify": "operators.rectify",
        "RegionDepth": "operators.depth.region",
        "RemoveMean": "operators.mean",
        "Resample": "operators.resample",
        "Scale": "operators.scale",
        "Segment": "operators.segmentation",
        "Select": "operators.channels",
        "SignalQuality": "operators.emg.quality",
        "Simplify": "operators.depth.simplify",
        "SkipRest": "operators.features.rest",
        "SleepPeriods": "operators.sleep.periods",
        "SleepScorer": "operators.sleep.scorer",
        "SleepStatistics": "operators.sleep.statistics",
        "Stack": "operators.features.stack",
        "Standardise": "operators.features.standardise",
        "SwitchContacts": "operators.gait.force",
        "Threshold": "operators.threshold",
        "View": "operators.depth.view",
    },
)
