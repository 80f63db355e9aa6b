"""When somebody goes to bed and gets up every day, as a person gives it: 22:30-07:00 in a time zone."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import ParameterError


@dataclass(frozen=True, slots=True)
class BedSchedule:
    """`evening`, `morning`: since midnight, in `zone`."""

    evening: timedelta
    morning: timedelta
    zone: ZoneInfo

    @classmethod
    def read(cls, schedule: str, timezone: str) -> BedSchedule | None:
        """HH:MM-HH:MM; None where it is left empty. Raises ParameterError."""
        try:
            zone = ZoneInfo(timezone)
        except (ZoneInfoNotFoundError, ValueError):
            raise ParameterError("timezone", timezone, "a time zone's name, like Europe/Berlin") from None
        if not schedule:
            return None
        try:
            evening, morning = (datetime.strptime(text.strip(), "%H:%M") for text in schedule.split("-"))
        except ValueError:
            raise ParameterError("schedule", schedule, "two times of day, like 22:30-07:00") from None
        if evening == morning:
            raise ParameterError("schedule", schedule, "two different times of day")
        midnight = datetime(1900, 1, 1)
        return cls(evening - midnight, morning - midnight, zone)

    def night_after(self, time: int) -> tuple[int, int]:
        """The first night that ends after `time`: its begin and end (ns)."""
        here = datetime.fromtimestamp(time // NS, UTC).astimezone(self.zone)
        day = here.replace(hour=0, minute=0, second=0, tzinfo=None)
        for days in (-2, -1, 0, 1):
            begin = day + timedelta(days=days) + self.evening
            end = day + timedelta(days=days + (self.morning <= self.evening)) + self.morning
            first, stop = (int(t.replace(tzinfo=self.zone).timestamp()) * NS for t in (begin, end))
            if stop > time:
                return first, stop
        return time, time + 1
