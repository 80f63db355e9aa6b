"""Where streams begin and end: devices, simulators, files, the screen."""

from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from devices.actigraph import Actigraph
    from devices.alarms import Alarms
    from devices.ascii_lines import AsciiLines
    from devices.bedside import Bedside
    from devices.binary import Binary
    from devices.bitalino import Bitalino
    from devices.csv_file import CsvFile
    from devices.cycle_table import CycleTable
    from devices.cyton import Cyton
    from devices.depthai_replay import DepthaiReplay
    from devices.exerciser import Exerciser
    from devices.lsl import LslInlet, LslOutlet
    from devices.mqtt import MqttOutlet, MqttSwitch
    from devices.mti import Mti
    from devices.night import NightLog
    from devices.oak import Oak
    from devices.report import SessionReport
    from devices.shimmer import Shimmer
    from devices.simulators.oak import SimulatedOak
    from devices.treadmill import Treadmill
    from devices.trigno import Trigno
    from devices.usb.endpoint import Endpoint
    from devices.walkway import Walkway

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
        "Actigraph": "devices.actigraph",
        "Alarms": "devices.alarms",
        "AsciiLines": "devices.ascii_lines",
        "Bedside": "devices.bedside",
        "Binary": "devices.binary",
        "Bitalino": "devices.bitalino",
        "CsvFile": "devices.csv_file",
        "CycleTable": "devices.cycle_table",
        "Cyton": "devices.cyton",
        "DepthaiReplay": "devices.depthai_replay",
        "Endpoint": "devices.usb.endpoint",
        "Exerciser": "devices.exerciser",
        "LslInlet": "devices.lsl",
        "LslOutlet": "devices.lsl",
        "MqttOutlet": "devices.mqtt",
        "MqttSwitch": "devices.mqtt",
        "Mti": "devices.mti",
        "NightLog": "devices.night",
        "Oak": "devices.oak",
        "SessionReport": "devices.report",
        "Shimmer": "devices.shimmer",
        "SimulatedOak": "devices.simulators.oak",
        "Treadmill": "devices.treadmill",
        "Trigno": "devices.trigno",
        "Walkway": "devices.walkway",
    },
)
