"""Small files in the grammars of laboratories' programs, with invented numbers; they are not vendors' files."""

from __future__ import annotations

import numpy as np

EMGWORKS = 'X[s],"Avanti sensor 1: EMG 1",X[s],"Avanti sensor 1: ACC.X 1",X[s],"Avanti sensor 2: EMG 2"\n' + "".join(
    f"{k * 0.0005192308:.7g},{1e-5 * k:.3g}"
    + (f",{k * 0.00675:.7g},{0.1 * k:.3g}" if k < 12 else ",,")
    + (f",{k * 0.0007941176:.7g},{2e-5 * k:.3g}\n" if k < 40 else ",,\n")
    for k in range(60)
)
DISCOVER = (
    "Application:, Trigno Discover (1.7.0)\nDate/Time:, 4/12/2024 5:23:09 PM\nCollection Length (seconds):, 0.1\n"
    "Left TA (54717), , , Right TA (55240)\nsensor mode: 55, , , sensor mode: 55\n"
    "EMG 1 (mV), ACC X (G), ACC Y (G), EMG 1 (mV)\n1259.2593 Hz, 148.1481 Hz, 148.1481 Hz, 1259.2593 Hz\n"
) + "".join(f"{0.01 * k}, {f'{k / 10}, {k / 20}' if k < 8 else ', '}, {-0.01 * k}\n" for k in range(60))
NORAXON = (
    '"type";"begin_time";"frequency";"count";"created with version";"last_name";"first_name";"born";"sex";"measurement_date"\n'
    '"record";"0,00000";"2000.4";"40";"myoRESEARCH 4.2.22";"Doe";"Jane";"1980-01-01";"female";"2025-01-01T10:00:00.000+01:00"\n\n'
    '"time";"Activity";"Marker";"BICEPS BR. LT (uV)";"ELBOW (deg)"\n'
) + "".join(
    f"{k / 2000.4:.5f};{'Lifting' if k == 3 else ''};{'up' if k in (7, 20) else ''};{k * 1.25};{k - 10}\n".replace(
        ".", ","
    )
    for k in range(40)
)
VICON = (
    "Devices\n1000\n,,Force Plate,,Imported EMG\nFrame,Sub Frame,Fz,Mx,EMG1\n,,N,N.mm,V\n"
    + "".join(f"{833 + k // 10},{k % 10},{-700 - k},{k * 2},{-2.5e-05 * k:.6E}\n" for k in range(50))
    + "\nTrajectories\n100\n,,Joe:LTOE,,,Joe:RTOE\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
    + "".join(f"{833 + k},0,{k},{k + 1},{k + 2}," + (",,\n" if k == 2 else f"{k},0,1\n") for k in range(5))
    + "\nEvents\n100\nSubject,Context,Name,Time (s),Description\n"
    "Joe,Right,Foot Strike,8.34,heel\nJoe,Left,Foot Off,8.33,toe\nJoe,Right,Foot Strike,8.33,\n"
)
VICON_EUROPE = "Devices\n1000\n;;Plate\nFrame;Sub Frame;Fz\n;;N\n" + "".join(
    f"{1 + k // 10};{k % 10};{k},5\n" for k in range(30)
)
QUALISYS = (
    "NO_OF_FRAMES\t20\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nDESCRIPTION\t--\n"
    "TIME_STAMP\t2022-06-03, 10:47:36.627\nTIME_STAMP\t2022-06-03, 10:47:36.627\t94247.4\nDATA_INCLUDED\t3D\n"
    "EVENT\tjump\t12\t0.11\nMARKER_NAMES\tA\tB\nFrame\tTime\tA X\tA Y\tA Z\tB X\tB Y\tB Z\n"
) + "".join(
    f"{k + 1}\t{k / 100:.5f}\t{k}\t1\t2\t" + ("0.000\t0.000\t0.000\n" if k == 5 else f"3\t{k}\t5\n") for k in range(20)
)
TRC = (
    "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\n250\t250\t10\t2\tm\t250\n"
    "Frame#\tTime\tLTOE\t\t\tRTOE\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
) + "".join(
    f"{k + 1}\t{k * 0.04:.4f}\t{k * 1e-2:.2E}\t      0.5\t1\t" + ("\tNan\tNAN\n" if k == 3 else "1\t2\t3\n")
    for k in range(10)
)
STORAGE = (
    "grf\nversion=1\nnRows=250\nnColumns=3\ninDegrees=no\n\nfree words\nendheader\ntime\tground_force_vy\tpelvis_tx\t\n"
    + "".join(f"  {k / 100:.4f}\t{700 + k}\t{k / 10}\t\n" for k in range(20))
)
COORDINATES = (
    "Coordinates,,\nversion=1,,\nnRows=20,,\ninDegrees=yes,,\nendheader,,\ntime,knee_angle_r,pelvis_tx\n"
    + "".join(f"{k / 100:.4f},{k},{k / 10}\n" for k in range(20))
)
QUATERNIONS = "DataRate=100.000000\nDataType=Quaternion\nversion=3\nendheader\ntime\tpelvis_imu\ttibia_imu\n" + "".join(
    f"{k / 100:g}\t1,0,0,{k / 100}\t0,1,0,0\n" for k in range(20)
)
MT_MANAGER = (
    "// General information: \n// Update Rate: 100.0Hz\n//  DeviceId: 00B4\nPacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tRoll\n"
    + "".join(f"{n:05d}\t\t{n / 10}\t0\t9.81\tNaN\n" for n in (65533, 65534, 65535, 0, 1, 4, 5))
)
APDM = (
    "Format=7,57,,,Lumbar,,,58,,,Ankle,,\nTime,Accelerometer,,,Barometer,Orientation,,Accelerometer,,,Barometer,Orientation,\n"
    ",X,Y,Z,,S,X,X,Y,Z,,S,X\n"
) + "".join(
    f"{1550879504438281 + k * 7812 + k % 2},{k},2,3,4636858284341460992.0,1,0,4,5,6,101.3,1,0\n" for k in range(12)
)
FORCES = (
    "[Force Data]\nNumberOfForcePlates=1\nSampleRate=300.000000\nNumberOfSamples=30\n#Sample\tFX1\tFY1\tFZ1\tX1\tY1\tZ1\tMZ1\n"
    + "".join(f"{k + 1}\t1\t2\t{700 + k}\t10\t20\t0\t5\n" for k in range(30))
)
ANC = (
    "File_Type:\tAnalog R/C ASCII\tGeneration#:\t2\nBoard_Type:\tPCI\tPolarity:\tBipolar\nTrial_Name:\tx\tTrial#:\t1\n"
    "BitDepth:\t16\tPreciseRate:\t300.000000\n\n\n\n\nName\tF1X\tEMG\t\nRate\t300\t300\t\nRange\t5000\t10000\t\n"
) + "".join(f"{k / 300:.6f}\t{k * 100}\t{-k}\t\n" for k in range(30))
MVNX = (
    (
        '<?xml version="1.0"?>\n<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4"><subject label="Jane Doe" frameRate="60" '
        'recDate="Tue Nov 13 05:17:11.827 2018"><segments><segment label="Pelvis" id="1"/><segment label="L5" id="2"/></segments>'
        '<joints><joint label="jL5S1"/></joints><frames>\n'
        '<frame time="0" ms="0" type="tpose"><orientation>1 0 0 0 1 0 0 0</orientation><position>0 0 1 0 0 1.1</position></frame>\n'
    )
    + "".join(
        f'<frame time="{round(k * 50 / 3)}" index="{k}" ms="{1542082631842 + round(k * 50 / 3)}" type="normal"><orientation>1 0 0 0 1 0 0 0'
        f"</orientation><position>{k} 0 1 0 0 1.1</position><jointAngle>0 0 {k}</jointAngle></frame>\n"
        for k in range(20)
        if k != 7
    )
    + "</frames></subject></mvnx>\n"
)
PLATE = "Bertec-like export\nof nobody's\nTime (s)\tFz\tMx\n(s)\t(N)\t(N.m)\n" + "".join(
    f"{k / 100:.2f}\t{700 + k}\t{k / 10}\n" for k in range(20)
)
BIDS = "".join(f"{k}\t1\t2\t{'n/a' if k == 3 else k / 2}\n" for k in range(20))
BIDS_CHANNELS = (
    "name\tcomponent\ttype\ttracked_point\tunits\nhx\tx\tPOS\thip\tmm\nhy\ty\tPOS\thip\tmm\n"
    "hz\tz\tPOS\thip\tmm\na\tn/a\tMISC\tn/a\tV\n"
)

TEXTS = {
    "emgworks.csv": EMGWORKS, "discover.csv": DISCOVER, "noraxon.csv": NORAXON, "vicon.csv": VICON, "europe.csv": VICON_EUROPE,
    "qualisys.tsv": QUALISYS, "markers.trc": TRC, "forces.mot": STORAGE, "coordinates.mot": COORDINATES, "imus.sto": QUATERNIONS,
    "mt.txt": MT_MANAGER, "apdm.csv": APDM, "cortex.forces": FORCES, "cortex.anc": ANC, "mini.mvnx": MVNX,
}  # fmt: skip
"""Each by a name that a file of it may have."""


def matlab_arrays() -> dict[str, object]:
    """What a laboratory's own script saves: a structure with signals, names and a rate."""
    emg = np.arange(200.0).reshape(2, 100) / 1e3
    return {"trial": {"emg": emg, "names": np.array(["TA", "GM"], object), "fs": 1000.0}, "note": "made by a test"}
