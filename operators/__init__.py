"""What is done to streams."""

from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from operators.align import Align
    from operators.arithmetic import Arithmetic
    from operators.body.background import Background
    from operators.body.extrema import Extrema
    from operators.body.markers import Markers
    from operators.body.persons import Persons
    from operators.body.pose_network import PoseNetwork
    from operators.body.relief import Relief
    from operators.body.surer import Surer
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
    from operators.emg.channel_watch import ChannelWatch
    from operators.emg.electrode_watch import ElectrodeWatch
    from operators.emg.median_frequency import MedianFrequency
    from operators.emg.mixture_drift import MixtureDrift
    from operators.emg.mixtures import PeakMixtures
    from operators.emg.normalise import Normalise
    from operators.emg.quality import SignalQuality
    from operators.extremes import MovingMax, MovingMin
    from operators.features.bundle import Bundle
    from operators.features.mirror import Mirror
    from operators.features.normalised_pose import NormalisedPose
    from operators.features.pose import Pose
    from operators.features.rest import SkipRest
    from operators.features.self_similarity import SelfSimilarity
    from operators.features.stack import Stack
    from operators.features.standardise import Standardise
    from operators.features.weigh import Weigh
    from operators.force_plate import ForcePlate
    from operators.gait.acceleration import AccelerationContacts
    from operators.gait.bursts import CycleBursts
    from operators.gait.cycle_targets import CycleTargets
    from operators.gait.cycle_watch import CycleWatch
    from operators.gait.cycles import Cycles
    from operators.gait.ensemble import CycleEnsemble
    from operators.gait.footfalls import Footfalls
    from operators.gait.force import ForceContacts, SwitchContacts
    from operators.gait.inertial import InertialContacts
    from operators.gait.leg_contacts import LegContacts
    from operators.gait.limb_contacts import LimbContacts
    from operators.gait.limb_cycles import LimbCycles
    from operators.gait.limb_watch import LimbWatch
    from operators.gait.marker import MarkerContacts
    from operators.gait.marker_watch import MarkerWatch
    from operators.gait.norms import NormativeBands
    from operators.gait.pattern_watch import PatternWatch
    from operators.gait.review import CycleReview
    from operators.gait.stage_curves import StageCurves
    from operators.gait.stages import Stages
    from operators.gait.statistics import CycleStatistics
    from operators.gait.stride_shape import StrideShape
    from operators.gait.symmetry import LimbSymmetry
    from operators.gait.timing_watch import TimingWatch
    from operators.gaps import FillGaps
    from operators.gate import Gate
    from operators.iir import Bandpass, Highpass, Lowpass, Notch
    from operators.mean import RemoveMean
    from operators.motion_graph.growing import GrowingGraph
    from operators.motion_map import MotionMap
    from operators.moving import MovingMean, MovingRms
    from operators.neighbours import Neighbours
    from operators.one_euro import OneEuro
    from operators.pause import Pause
    from operators.pose_map.retrieve import Retrieve
    from operators.pose_map.som import PoseGrid
    from operators.predict import Predict
    from operators.rectify import Rectify
    from operators.resample import Resample
    from operators.scale import Scale
    from operators.segmentation import Segment
    from operators.segmentation.naming import NameRepetitions
    from operators.sleep.epochs import Epochs
    from operators.sleep.gentle_alarm import GentleAlarm
    from operators.sleep.nights import Nights
    from operators.sleep.periods import SleepPeriods
    from operators.sleep.scorer import SleepScorer
    from operators.sleep.statistics import SleepStatistics
    from operators.smooth import Binomial
    from operators.steering.actors import Actors
    from operators.steering.operator import SteerMesh
    from operators.steps.activity import StepActivity
    from operators.steps.classifier import StepClassifier
    from operators.steps.steps import Steps
    from operators.threshold import Threshold
    from operators.turn_axes import TurnAxes
    from operators.whole_pose.footing import Footing
    from operators.whole_pose.operator import WholePose

__all__ = [
    "AccelerationContacts",
    "Activity",
    "Actors",
    "Align",
    "Arithmetic",
    "Background",
    "Bandpass",
    "BedRegion",
    "Binomial",
    "Breathing",
    "Bundle",
    "ChannelWatch",
    "CycleBursts",
    "CycleEnsemble",
    "CycleReview",
    "CycleStatistics",
    "CycleTargets",
    "CycleWatch",
    "Cycles",
    "Decimate",
    "Derivative",
    "ElectrodeWatch",
    "Envelope",
    "Epochs",
    "Extrema",
    "FillGaps",
    "Footfalls",
    "Footing",
    "ForceContacts",
    "ForcePlate",
    "Gate",
    "GentleAlarm",
    "GrowingGraph",
    "Highpass",
    "InertialContacts",
    "LegContacts",
    "LimbContacts",
    "LimbCycles",
    "LimbSymmetry",
    "LimbWatch",
    "Lowpass",
    "MarkerContacts",
    "MarkerWatch",
    "Markers",
    "MedianFrequency",
    "Mirror",
    "MixtureDrift",
    "Motion",
    "MotionMap",
    "MovingMax",
    "MovingMean",
    "MovingMin",
    "MovingRms",
    "NameRepetitions",
    "Neighbours",
    "NightMap",
    "Nights",
    "Normalise",
    "NormalisedPose",
    "NormativeBands",
    "Notch",
    "OneEuro",
    "PatternWatch",
    "Pause",
    "PeakMixtures",
    "Persons",
    "Pose",
    "PoseGrid",
    "PoseNetwork",
    "Predict",
    "Presence",
    "Rectify",
    "RegionDepth",
    "Relief",
    "RemoveMean",
    "Resample",
    "Retrieve",
    "Scale",
    "Segment",
    "Select",
    "SelfSimilarity",
    "SignalQuality",
    "Simplify",
    "SkipRest",
    "SleepPeriods",
    "SleepScorer",
    "SleepStatistics",
    "Stack",
    "StageCurves",
    "Stages",
    "Standardise",
    "SteerMesh",
    "StepActivity",
    "StepClassifier",
    "Steps",
    "StrideShape",
    "Surer",
    "SwitchContacts",
    "Threshold",
    "TimingWatch",
    "TurnAxes",
    "View",
    "Weigh",
    "WholePose",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "AccelerationContacts": "operators.gait.acceleration",
        "Activity": "operators.depth.activity",
        "Actors": "operators.steering.actors",
        "Align": "operators.align",
        "Arithmetic": "operators.arithmetic",
        "Background": "operators.body.background",
        "Bandpass": "operators.iir",
        "BedRegion": "operators.depth.bed",
        "Binomial": "operators.smooth",
        "Breathing": "operators.depth.breathing",
        "Bundle": "operators.features.bundle",
        "ChannelWatch": "operators.emg.channel_watch",
        "CycleBursts": "operators.gait.bursts",
        "CycleEnsemble": "operators.gait.ensemble",
        "CycleReview": "operators.gait.review",
        "CycleStatistics": "operators.gait.statistics",
        "CycleTargets": "operators.gait.cycle_targets",
        "CycleWatch": "operators.gait.cycle_watch",
        "Cycles": "operators.gait.cycles",
        "Decimate": "operators.decimate",
        "Derivative": "operators.derivative",
        "ElectrodeWatch": "operators.emg.electrode_watch",
        "Envelope": "operators.emg",
        "Epochs": "operators.sleep.epochs",
        "Extrema": "operators.body.extrema",
        "FillGaps": "operators.gaps",
        "Footfalls": "operators.gait.footfalls",
        "Footing": "operators.whole_pose.footing",
        "ForceContacts": "operators.gait.force",
        "ForcePlate": "operators.force_plate",
        "Gate": "operators.gate",
        "GentleAlarm": "operators.sleep.gentle_alarm",
        "GrowingGraph": "operators.motion_graph.growing",
        "Highpass": "operators.iir",
        "InertialContacts": "operators.gait.inertial",
        "LegContacts": "operators.gait.leg_contacts",
        "LimbContacts": "operators.gait.limb_contacts",
        "LimbCycles": "operators.gait.limb_cycles",
        "LimbSymmetry": "operators.gait.symmetry",
        "LimbWatch": "operators.gait.limb_watch",
        "Lowpass": "operators.iir",
        "MarkerContacts": "operators.gait.marker",
        "MarkerWatch": "operators.gait.marker_watch",
        "Markers": "operators.body.markers",
        "MedianFrequency": "operators.emg.median_frequency",
        "Mirror": "operators.features.mirror",
        "MixtureDrift": "operators.emg.mixture_drift",
        "Motion": "operators.depth.motion",
        "MotionMap": "operators.motion_map",
        "MovingMax": "operators.extremes",
        "MovingMean": "operators.moving",
        "MovingMin": "operators.extremes",
        "MovingRms": "operators.moving",
        "NameRepetitions": "operators.segmentation.naming",
        "Neighbours": "operators.neighbours",
        "NightMap": "operators.depth.night_map",
        "Nights": "operators.sleep.nights",
        "Normalise": "operators.emg.normalise",
        "NormalisedPose": "operators.features.normalised_pose",
        "NormativeBands": "operators.gait.norms",
        "Notch": "operators.iir",
        "OneEuro": "operators.one_euro",
        "PatternWatch": "operators.gait.pattern_watch",
        "Pause": "operators.pause",
        "PeakMixtures": "operators.emg.mixtures",
        "Persons": "operators.body.persons",
        "Pose": "operators.features.pose",
        "PoseGrid": "operators.pose_map.som",
        "PoseNetwork": "operators.body.pose_network",
        "Predict": "operators.predict",
        "Presence": "operators.depth.presence",
        "Rectify": "operators.rectify",
        "RegionDepth": "operators.depth.region",
        "Relief": "operators.body.relief",
        "RemoveMean": "operators.mean",
        "Resample": "operators.resample",
        "Retrieve": "operators.pose_map.retrieve",
        "Scale": "operators.scale",
        "Segment": "operators.segmentation",
        "Select": "operators.channels",
        "SelfSimilarity": "operators.features.self_similarity",
        "SignalQuality": "operators.emg.quality",
        "Simplify": "operators.depth.simplify",
        "SkipRest": "operators.features.rest",
        "SleepPeriods": "operators.sleep.periods",
        "SleepScorer": "operators.sleep.scorer",
        "SleepStatistics": "operators.sleep.statistics",
        "Stack": "operators.features.stack",
        "StageCurves": "operators.gait.stage_curves",
        "Stages": "operators.gait.stages",
        "Standardise": "operators.features.standardise",
        "SteerMesh": "operators.steering.operator",
        "StepActivity": "operators.steps.activity",
        "StepClassifier": "operators.steps.classifier",
        "Steps": "operators.steps.steps",
        "StrideShape": "operators.gait.stride_shape",
        "Surer": "operators.body.surer",
        "SwitchContacts": "operators.gait.force",
        "Threshold": "operators.threshold",
        "TurnAxes": "operators.turn_axes",
        "TimingWatch": "operators.gait.timing_watch",
        "View": "operators.depth.view",
        "Weigh": "operators.features.weigh",
        "WholePose": "operators.whole_pose.operator",
    },
)
