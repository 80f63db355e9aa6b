"""What is done to streams."""

from typing import TYPE_CHECKING

from kinegraph.stream.system.lazy import offered

if __name__ != "kinegraph.operators":
    raise ImportError("the package is kinegraph.operators: write `from kinegraph.operators import ...`")

if TYPE_CHECKING:
    from kinegraph.operators.angles import JointAngles
    from kinegraph.operators.bed.activity import Activity
    from kinegraph.operators.bed.bed import BedRegion
    from kinegraph.operators.bed.breathing import Breathing
    from kinegraph.operators.bed.frames.region import RegionDepth
    from kinegraph.operators.bed.frames.simplify import Simplify
    from kinegraph.operators.bed.frames.view import View
    from kinegraph.operators.bed.motion import Motion
    from kinegraph.operators.bed.night_map import NightMap
    from kinegraph.operators.bed.presence import Presence
    from kinegraph.operators.body.background import Background
    from kinegraph.operators.body.camera.face import Face
    from kinegraph.operators.body.camera.hands import Hands
    from kinegraph.operators.body.camera.image_pose import ImagePose
    from kinegraph.operators.body.camera.one_camera import OneCamera
    from kinegraph.operators.body.extrema import Extrema
    from kinegraph.operators.body.marker_fusion import Surer
    from kinegraph.operators.body.markers import Markers
    from kinegraph.operators.body.network import PoseNetwork
    from kinegraph.operators.body.network.relief import Relief
    from kinegraph.operators.body.persons import Persons
    from kinegraph.operators.contacts.acceleration import AccelerationContacts
    from kinegraph.operators.contacts.force import ForceContacts, SwitchContacts
    from kinegraph.operators.contacts.force_plate import ForcePlate
    from kinegraph.operators.contacts.inertial import InertialContacts
    from kinegraph.operators.contacts.leg_contacts import LegContacts
    from kinegraph.operators.contacts.limb_contacts import LimbContacts
    from kinegraph.operators.contacts.marker import MarkerContacts
    from kinegraph.operators.cycles.cycles import Cycles
    from kinegraph.operators.cycles.limb_cycles import LimbCycles
    from kinegraph.operators.cycles.review import CycleReview
    from kinegraph.operators.cycles.stages import Stages
    from kinegraph.operators.cycles.statistics import CycleStatistics
    from kinegraph.operators.cycles.statistics.bursts import CycleBursts
    from kinegraph.operators.cycles.statistics.cycle_targets import CycleTargets
    from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
    from kinegraph.operators.cycles.statistics.median_frequency import MedianFrequency
    from kinegraph.operators.cycles.statistics.norms import NormativeBands
    from kinegraph.operators.cycles.statistics.stage_curves import StageCurves
    from kinegraph.operators.cycles.statistics.symmetry import LimbSymmetry
    from kinegraph.operators.emg import Envelope
    from kinegraph.operators.emg.mixtures import PeakMixtures
    from kinegraph.operators.emg.mixtures.drift import MixtureDrift
    from kinegraph.operators.emg.normalise import Normalise
    from kinegraph.operators.emg.quality import SignalQuality
    from kinegraph.operators.features.bundle import Bundle
    from kinegraph.operators.features.mirror import Mirror
    from kinegraph.operators.features.normalised_pose import NormalisedPose
    from kinegraph.operators.features.pose import Pose
    from kinegraph.operators.features.rest import SkipRest
    from kinegraph.operators.features.self_similarity import SelfSimilarity
    from kinegraph.operators.features.stack import Stack
    from kinegraph.operators.features.standardise import Standardise
    from kinegraph.operators.features.weigh import Weigh
    from kinegraph.operators.filters.arithmetic import Arithmetic
    from kinegraph.operators.filters.channels import Select
    from kinegraph.operators.filters.decimate import Decimate
    from kinegraph.operators.filters.derivative import Derivative
    from kinegraph.operators.filters.extremes import MovingMax, MovingMin
    from kinegraph.operators.filters.gaps import FillGaps
    from kinegraph.operators.filters.iir import Bandpass, Highpass, Lowpass, Notch
    from kinegraph.operators.filters.mean import RemoveMean
    from kinegraph.operators.filters.moving import MovingMean, MovingRms
    from kinegraph.operators.filters.one_euro import OneEuro
    from kinegraph.operators.filters.predict import Predict
    from kinegraph.operators.filters.rectify import Rectify
    from kinegraph.operators.filters.resample import Resample
    from kinegraph.operators.filters.scale import Scale
    from kinegraph.operators.filters.smooth import Binomial
    from kinegraph.operators.filters.threshold import Threshold
    from kinegraph.operators.filters.turn_axes import TurnAxes
    from kinegraph.operators.maps.motion_graph.growing import GrowingGraph
    from kinegraph.operators.maps.motion_map import MotionMap
    from kinegraph.operators.maps.pose_map.retrieve import Retrieve
    from kinegraph.operators.maps.pose_map.som import PoseGrid
    from kinegraph.operators.monitors.channel_watch import ChannelWatch
    from kinegraph.operators.monitors.cycle_watch import CycleWatch
    from kinegraph.operators.monitors.electrode_watch import ElectrodeWatch
    from kinegraph.operators.monitors.limb_watch import LimbWatch
    from kinegraph.operators.monitors.marker_watch import MarkerWatch
    from kinegraph.operators.monitors.pattern_watch import PatternWatch
    from kinegraph.operators.monitors.timing_watch import TimingWatch
    from kinegraph.operators.neighbours import Neighbours
    from kinegraph.operators.neighbours.returning import Returning
    from kinegraph.operators.pose import WholePose
    from kinegraph.operators.pose.footing import Footing
    from kinegraph.operators.segmentation import Segment
    from kinegraph.operators.segmentation.names.naming import NameRepetitions
    from kinegraph.operators.sleep.epochs import Epochs
    from kinegraph.operators.sleep.gentle_alarm import GentleAlarm
    from kinegraph.operators.sleep.nights import Nights
    from kinegraph.operators.sleep.periods import SleepPeriods
    from kinegraph.operators.sleep.scorer import SleepScorer
    from kinegraph.operators.sleep.statistics import SleepStatistics
    from kinegraph.operators.steering import SteerMesh
    from kinegraph.operators.steering.actors import Actors
    from kinegraph.operators.steps.activity import StepActivity
    from kinegraph.operators.steps.classifier import StepClassifier
    from kinegraph.operators.steps.step_statistics import StepStatistics
    from kinegraph.operators.steps.steps import Steps
    from kinegraph.operators.strides.footfalls import Footfalls
    from kinegraph.operators.strides.stride_manner import StrideManner
    from kinegraph.operators.strides.stride_shape import StrideShape
    from kinegraph.operators.synthesis import Synthesis
    from kinegraph.operators.synthesis.live import LiveWalk
    from kinegraph.operators.timing.align import Align
    from kinegraph.operators.timing.gate import Gate
    from kinegraph.operators.timing.pause import Pause

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
    "Face",
    "FillGaps",
    "Footfalls",
    "Footing",
    "ForceContacts",
    "ForcePlate",
    "Gate",
    "GentleAlarm",
    "GrowingGraph",
    "Hands",
    "Highpass",
    "ImagePose",
    "InertialContacts",
    "JointAngles",
    "LegContacts",
    "LimbContacts",
    "LimbCycles",
    "LimbSymmetry",
    "LimbWatch",
    "LiveWalk",
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
    "OneCamera",
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
    "Returning",
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
    "StepStatistics",
    "Steps",
    "StrideManner",
    "StrideShape",
    "Surer",
    "SwitchContacts",
    "Synthesis",
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
        "AccelerationContacts": "kinegraph.operators.contacts.acceleration",
        "Activity": "kinegraph.operators.bed.activity",
        "Actors": "kinegraph.operators.steering.actors",
        "Align": "kinegraph.operators.timing.align",
        "Arithmetic": "kinegraph.operators.filters.arithmetic",
        "Background": "kinegraph.operators.body.background",
        "Bandpass": "kinegraph.operators.filters.iir",
        "BedRegion": "kinegraph.operators.bed.bed",
        "Binomial": "kinegraph.operators.filters.smooth",
        "Breathing": "kinegraph.operators.bed.breathing",
        "Bundle": "kinegraph.operators.features.bundle",
        "ChannelWatch": "kinegraph.operators.monitors.channel_watch",
        "CycleBursts": "kinegraph.operators.cycles.statistics.bursts",
        "CycleEnsemble": "kinegraph.operators.cycles.statistics.ensemble",
        "CycleReview": "kinegraph.operators.cycles.review",
        "CycleStatistics": "kinegraph.operators.cycles.statistics",
        "CycleTargets": "kinegraph.operators.cycles.statistics.cycle_targets",
        "CycleWatch": "kinegraph.operators.monitors.cycle_watch",
        "Cycles": "kinegraph.operators.cycles.cycles",
        "Decimate": "kinegraph.operators.filters.decimate",
        "Derivative": "kinegraph.operators.filters.derivative",
        "ElectrodeWatch": "kinegraph.operators.monitors.electrode_watch",
        "Envelope": "kinegraph.operators.emg",
        "Epochs": "kinegraph.operators.sleep.epochs",
        "Extrema": "kinegraph.operators.body.extrema",
        "Face": "kinegraph.operators.body.camera.face",
        "FillGaps": "kinegraph.operators.filters.gaps",
        "Footfalls": "kinegraph.operators.strides.footfalls",
        "Footing": "kinegraph.operators.pose.footing",
        "ForceContacts": "kinegraph.operators.contacts.force",
        "ForcePlate": "kinegraph.operators.contacts.force_plate",
        "Gate": "kinegraph.operators.timing.gate",
        "GentleAlarm": "kinegraph.operators.sleep.gentle_alarm",
        "GrowingGraph": "kinegraph.operators.maps.motion_graph.growing",
        "Hands": "kinegraph.operators.body.camera.hands",
        "Highpass": "kinegraph.operators.filters.iir",
        "ImagePose": "kinegraph.operators.body.camera.image_pose",
        "InertialContacts": "kinegraph.operators.contacts.inertial",
        "JointAngles": "kinegraph.operators.angles",
        "LegContacts": "kinegraph.operators.contacts.leg_contacts",
        "LimbContacts": "kinegraph.operators.contacts.limb_contacts",
        "LimbCycles": "kinegraph.operators.cycles.limb_cycles",
        "LimbSymmetry": "kinegraph.operators.cycles.statistics.symmetry",
        "LimbWatch": "kinegraph.operators.monitors.limb_watch",
        "LiveWalk": "kinegraph.operators.synthesis.live",
        "Lowpass": "kinegraph.operators.filters.iir",
        "MarkerContacts": "kinegraph.operators.contacts.marker",
        "MarkerWatch": "kinegraph.operators.monitors.marker_watch",
        "Markers": "kinegraph.operators.body.markers",
        "MedianFrequency": "kinegraph.operators.cycles.statistics.median_frequency",
        "Mirror": "kinegraph.operators.features.mirror",
        "MixtureDrift": "kinegraph.operators.emg.mixtures.drift",
        "Motion": "kinegraph.operators.bed.motion",
        "MotionMap": "kinegraph.operators.maps.motion_map",
        "MovingMax": "kinegraph.operators.filters.extremes",
        "MovingMean": "kinegraph.operators.filters.moving",
        "MovingMin": "kinegraph.operators.filters.extremes",
        "MovingRms": "kinegraph.operators.filters.moving",
        "NameRepetitions": "kinegraph.operators.segmentation.names.naming",
        "Neighbours": "kinegraph.operators.neighbours",
        "NightMap": "kinegraph.operators.bed.night_map",
        "Nights": "kinegraph.operators.sleep.nights",
        "Normalise": "kinegraph.operators.emg.normalise",
        "NormalisedPose": "kinegraph.operators.features.normalised_pose",
        "NormativeBands": "kinegraph.operators.cycles.statistics.norms",
        "Notch": "kinegraph.operators.filters.iir",
        "OneCamera": "kinegraph.operators.body.camera.one_camera",
        "OneEuro": "kinegraph.operators.filters.one_euro",
        "PatternWatch": "kinegraph.operators.monitors.pattern_watch",
        "Pause": "kinegraph.operators.timing.pause",
        "PeakMixtures": "kinegraph.operators.emg.mixtures",
        "Persons": "kinegraph.operators.body.persons",
        "Pose": "kinegraph.operators.features.pose",
        "PoseGrid": "kinegraph.operators.maps.pose_map.som",
        "PoseNetwork": "kinegraph.operators.body.network",
        "Predict": "kinegraph.operators.filters.predict",
        "Presence": "kinegraph.operators.bed.presence",
        "Rectify": "kinegraph.operators.filters.rectify",
        "RegionDepth": "kinegraph.operators.bed.frames.region",
        "Relief": "kinegraph.operators.body.network.relief",
        "RemoveMean": "kinegraph.operators.filters.mean",
        "Resample": "kinegraph.operators.filters.resample",
        "Retrieve": "kinegraph.operators.maps.pose_map.retrieve",
        "Returning": "kinegraph.operators.neighbours.returning",
        "Scale": "kinegraph.operators.filters.scale",
        "Segment": "kinegraph.operators.segmentation",
        "Select": "kinegraph.operators.filters.channels",
        "SelfSimilarity": "kinegraph.operators.features.self_similarity",
        "SignalQuality": "kinegraph.operators.emg.quality",
        "Simplify": "kinegraph.operators.bed.frames.simplify",
        "SkipRest": "kinegraph.operators.features.rest",
        "SleepPeriods": "kinegraph.operators.sleep.periods",
        "SleepScorer": "kinegraph.operators.sleep.scorer",
        "SleepStatistics": "kinegraph.operators.sleep.statistics",
        "Stack": "kinegraph.operators.features.stack",
        "StageCurves": "kinegraph.operators.cycles.statistics.stage_curves",
        "Stages": "kinegraph.operators.cycles.stages",
        "Standardise": "kinegraph.operators.features.standardise",
        "SteerMesh": "kinegraph.operators.steering",
        "StepActivity": "kinegraph.operators.steps.activity",
        "StepClassifier": "kinegraph.operators.steps.classifier",
        "StepStatistics": "kinegraph.operators.steps.step_statistics",
        "Steps": "kinegraph.operators.steps.steps",
        "StrideManner": "kinegraph.operators.strides.stride_manner",
        "StrideShape": "kinegraph.operators.strides.stride_shape",
        "Surer": "kinegraph.operators.body.marker_fusion",
        "SwitchContacts": "kinegraph.operators.contacts.force",
        "Synthesis": "kinegraph.operators.synthesis",
        "Threshold": "kinegraph.operators.filters.threshold",
        "TimingWatch": "kinegraph.operators.monitors.timing_watch",
        "TurnAxes": "kinegraph.operators.filters.turn_axes",
        "View": "kinegraph.operators.bed.frames.view",
        "Weigh": "kinegraph.operators.features.weigh",
        "WholePose": "kinegraph.operators.pose",
    },
)
