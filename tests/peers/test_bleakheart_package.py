"""bleakheart, a driver written elsewhere, reads the simulated Polar belt as we do, bit for bit."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.ble.simulated_radio import SimulatedRadio, radio
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.polar.protocol import PmdDecoder
from kinegraph.devices.polar.simulator import PolarBelt

bleak = pytest.importorskip("bleak")
bleakheart = pytest.importorskip("bleakheart")


async def _listen(air: SimulatedRadio) -> tuple[list[Any], list[Any]]:
    """Frames as bleakheart tells them, and the bytes that they were made from."""
    rows: list[Any] = []
    came: list[Any] = []
    device = await bleak.BleakScanner.find_device_by_name("Polar H10 12345678", backend=air.scanner)
    async with bleak.BleakClient(device, backend=air.client) as client:
        heart = bleakheart.HeartRate(client, callback=rows.append)
        measured = bleakheart.PolarMeasurementData(client, callback=rows.append)
        for one, name in ((heart, "_handler"), (measured, "_pmd_data_handler")):
            _keep(one, name, came)
        await heart.start_notify()
        for kind, settings in (("ECG", {}), ("ACC", {"RANGE": 8, "SAMPLE_RATE": 200})):
            error, text, _ = await measured.start_streaming(kind, **settings)
            assert error == 0, text
        while {"HR", "ECG", "ACC"} - {frame[0] for frame in rows}:
            await asyncio.sleep(0.02)
        for kind in ("ECG", "ACC"):
            await measured.stop_streaming(kind)
    return rows, came


def _keep(one: Any, name: str, came: list[Any]) -> None:
    before = getattr(one, name)

    async def handler(characteristic: Any, data: bytearray) -> None:
        came.append(bytes(data))
        await before(characteristic, data)

    setattr(one, name, handler)


@pytest.mark.timeout(60)
def test_bleakheart_reads_what_we_read() -> None:
    with radio() as air:
        belt = PolarBelt()
        air.put(belt)
        output, came = asyncio.run(_listen(air))
    decoder = PmdDecoder()
    compared = set()
    for (kind, _, payload, *_rest), data in zip(output, came, strict=True):
        compared.add(kind)
        if kind == "HR":
            ours = heart_rate.parse(data)
            assert ours is not None and payload == (ours.bpm, round(ours.rr_s[-1] * 1000))
            continue
        frame = decoder.frame(data)
        assert frame is not None
        values = frame.data[:, 0] if kind == "ECG" else np.round(frame.data * 1000)
        assert np.array_equal(values, payload)
    assert compared == {"HR", "ECG", "ACC"} and not belt.running
