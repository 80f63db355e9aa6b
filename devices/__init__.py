"""Where streams begin and end: devices, simulators, files, the screen."""

from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from devices.alarms import Alarms
    from devices.ascii_lines import AsciiLines
    from devices.binary import Binary
    from devices.bitalino import Bitalino
    from devices.cyton import Cyton
    from devices.files.depthai_replay import DepthaiReplay
    from devices.lsl import LslInlet
    from devices.mqtt import MqttSwitch
    from devices.mti import Mti
    from devices.oak import Oak
    from devices.outlets.csv_file import CsvFile
    from devices.outlets.cycle_table import CycleTable
    from devices.outlets.lsl import LslOutlet
    from devices.outlets.mqtt import MqttOutlet
    from devices.outlets.night import NightLog
    from devices.outlets.report import SessionReport
    from devices.shimmer import Shimmer
    from devices.simulators.actigraph import Actigraph
    from devices.simulators.bedside import Bedside
    from devices.simulators.exerciser import Exerciser
    from devices.simulators.oak import SimulatedOak
    from devices.simulators.treadmill import Treadmill
    from devices.simulators.walkway import Walkway
    from devices.trigno import Trigno
    from devices.usb.endpoint import Endpoint

__all__ = [
    "Actigraph",
    "Alarms",
    "AsciiLines",
    "Bedside",
    "Binary",
    "Bitalino",
    "CsvFile",
    "CycleTable",
    "Cyton",
    "DepthaiReplay",
    "Endpoint",
    "Exerciser",
    "LslInlet",
    "LslOutlet",
    "MqttOutlet",
    "MqttSwitch",
    "Mti",
    "NightLog",
    "Oak",
    "SessionReport",
    "Shimmer",
    "SimulatedOak",
    "Treadmill",
    "Trigno",
    "Walkway",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "Actigraph": "devices.simulators.actigraph",
        "Alarms": "devices.alarms",
        "AsciiLines": "devices.ascii_lines",
        "Bedside": "devices.simulators.bedside",
        "Binary": "devices.binary",
        "Bitalino": "devices.bitalino",
        "CsvFile": "devices.outlets.csv_file",
        "CycleTable": "devices.outlets.cycle_table",
        "Cyton": "devices.cyton",
        "DepthaiReplay": "devices.files.depthai_replay",
        "Endpoint": "devices.usb.endpoint",
        "Exerciser": "devices.simulators.exerciser",
        "LslInlet": "devices.lsl",
        "LslOutlet": "devices.outlets.lsl",
        "MqttOutlet": "devices.outlets.mqtt",
        "MqttSwitch": "devices.mqtt",
        "Mti": "devices.mti",
        "NightLog": "devices.outlets.night",
        "Oak": "devices.oak",
        "SessionReport": "devices.outlets.report",
        "Shimmer": "devices.shimmer",
        "SimulatedOak": "devices.simulators.oak",
        "Treadmill": "devices.simulators.treadmill",
        "Trigno": "devices.trigno",
        "Walkway": "devices.simulators.walkway",
    },
)
