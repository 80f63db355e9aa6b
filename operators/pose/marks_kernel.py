"""Which landmarks a sample shows: gathered from its markers, doubted where one leaps, and guessed where one is not seen."""

from __future__ import annotations

import math

from kinegraph.operators.pose.limb_kernel import (
    ANKLE_AT,
    ELBOW_AT,
    HEAD_AT,
    HIP_AT,
    KNEE_AT,
    ROOT_AT,
    SHOULDER_AT,
    WRIST_AT,
)
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel

LEAP_M, LEAP_M_S, DOUBTED = 0.3, 8.0, 3
"""A marker farther from where it is expected than this, and this times the period, is not believed for this many samples."""
EASES_S, EASES_M = 0.08, 1.0
"""A marker that is seen again is gone to by degrees, this quickly; not where it is farther away, or no marker was seen before."""
FOLLOWS_S, TRUSTS_S = 0.2, 0.3
"""A marker is followed with the first as its time constant times the square of the doubt about it: in the mean it is nearer to where it
should be than any guess. Doubt rises at once, and takes at least the second to fall from 1 to 0."""
STILL_M = 0.12
"""Who stands for the calibration keeps hips, knees, ankles and shoulders within this distance."""
NEEDED = 8
"""The first landmarks are hips, knees, ankles and shoulders: a sample of standing shows them all. Hands may be hidden beside the thighs."""


@kernel
def gather(
    row: Samples, sure: Samples, columns: Times, axes: Times, signs: Samples, marks: Samples, seen: Array, hinted: Array,
    surest: Samples, counts: Samples,
) -> int:  # fmt: skip
    """Landmarks (m, 3) in metres, y up, from a sample `row` (width,); one that lacks a point is not `seen`. Returns how many are.

    sure    (points,)  how sure each point is, up to 1; a landmark with a point below that is not seen, but only `hinted` at (m,)
    surest  (m,)       how sure each landmark is at most: as its least sure point
    """
    marks[:] = 0.0
    seen[:] = True
    surest[:] = 1.0
    counts[:] = 0.0
    for c in range(columns.shape[0]):
        k = columns[c, 3]
        counts[k] += 1.0
        surest[k] = min(surest[k], sure[columns[c, 0] // 3])
        for a in range(3):
            v = row[columns[c, axes[a]]]
            if v != v:
                seen[k] = False
            marks[k, a] += signs[a] * v
    found = 0
    for k in range(marks.shape[0]):
        seen[k] = seen[k] and counts[k] > 0.0
        hinted[k] = surest[k] < 1.0 and seen[k]
        if seen[k]:
            for a in range(3):
                marks[k, a] /= counts[k]
        if hinted[k]:
            seen[k] = False
        found += seen[k]
    return found


@kernel
def shift_of(marks: Samples, before: Samples, seen: Array, shift: Samples) -> None:
    """By how much the trunk has moved since `before` (m, 3), into `shift` (3,): the mean of its landmarks; without one of these, of all."""
    for trunk in range(2):
        n = 0
        shift[:] = 0.0
        for k in range(marks.shape[0]):
            of_trunk = k in (HIP_AT, HIP_AT + 1, SHOULDER_AT, SHOULDER_AT + 1) or HEAD_AT <= k <= ROOT_AT
            if seen[k] and (of_trunk or trunk == 1):
                n += 1
                for a in range(3):
                    shift[a] += marks[k, a] - before[k, a]
        if n:
            for a in range(3):
                shift[a] /= n
            return


@kernel
def complete_marks(
    marks: Samples,
    before: Samples,
    seen: Array,
    hinted: Array,
    present: Array,
    surest: Samples,
    trusts: Samples,
    doubts: Samples,
    eases: Samples,
    dt: float,
    shift: Samples,
) -> tuple[int, bool]:
    """Put guesses in place of landmarks that are present in the stream and not seen now; returns how many are seen after the doubtful
    ones, and whether any was in the sample before.

    before  (m, 3) where the landmarks were; a guess has moved with the trunk, and towards the marker where that is `hinted` at (m,)
    surest (m,), trusts (m,)  how far each landmark is to be trusted at most, and is: less than 1 where it has been doubtful of late
    doubts  (m,)   for how many samples each has been doubted
    eases  (m, 4)  how far each still is from its marker since it was seen again, and whether no marker showed it in the sample before
    """
    shift_of(marks, before, seen, shift)
    ease, followed = math.exp(-dt / EASES_S), 0
    for k in range(marks.shape[0]):
        followed += present[k] and eases[k, 3] == 0.0
    limit = LEAP_M + LEAP_M_S * dt
    found = 0
    for k in range(marks.shape[0]):
        if not present[k]:
            continue
        if seen[k]:
            d = 0.0
            for a in range(3):
                d += (marks[k, a] - before[k, a] - shift[a]) ** 2
            doubts[k] = doubts[k] + 1.0 if math.sqrt(d) > limit else 0.0
            if 0.0 < doubts[k] <= DOUBTED:
                seen[k] = False
            else:
                doubts[k] = 0.0
        trusts[k] = min(surest[k], trusts[k] + dt / TRUSTS_S)
        found += seen[k]
        if trusts[k] < 1.0 and (seen[k] or hinted[k]):
            share = 1.0 - math.exp(-dt / (FOLLOWS_S * (1.0 - trusts[k]) ** 2))
            for a in range(3):
                expected = before[k, a] + shift[a]
                marks[k, a] = expected + share * (marks[k, a] - expected)
                eases[k, a] = 0.0
        elif seen[k]:
            if eases[k, 3] > 0.0:
                for a in range(3):
                    away = before[k, a] + shift[a] - marks[k, a]
                    eases[k, a] = away if followed and abs(away) < EASES_M else 0.0
            for a in range(3):
                eases[k, a] *= ease
                marks[k, a] += eases[k, a]
        else:
            for a in range(3):
                marks[k, a] = before[k, a] + shift[a]
        eases[k, 3] = 0.0 if seen[k] or hinted[k] else 1.0
    return found, followed > 0


@kernel
def stand(marks: Samples, seen: Array, present: Array, total: Samples, frames: float) -> float:
    """Add a sample of someone who stands still to the sums `total` (m, 3) of `frames` samples; returns how many it holds then.

    Where hips, knees, ankles or shoulders are not seen nothing is added; where one of them has moved, the sums begin with this sample.
    """
    for k in range(NEEDED):
        if present[k] and not seen[k]:
            return frames
    if frames > 0.0:
        for k in range(NEEDED):
            if present[k]:
                d = 0.0
                for a in range(3):
                    d += (marks[k, a] - total[k, a] / frames) ** 2
                if d > STILL_M * STILL_M:
                    frames = 0.0
    if frames == 0.0:
        total[:] = 0.0
    total += marks
    return frames + 1.0


@kernel
def apart(mean: Samples, present: Array, a: int, b: int) -> float:
    """The mean distance of landmarks `a` and `b`, left and right; 0 where the stream lacks them."""
    total, n = 0.0, 0
    for side in range(2):
        if present[a + side] and present[b + side]:
            d = 0.0
            for x in range(3):
                d += (mean[a + side, x] - mean[b + side, x]) ** 2
            total += math.sqrt(d)
            n += 1
    return total / n if n else 0.0


@kernel
def across(mean: Samples, present: Array, a: int, b: int) -> float:
    """The distance of landmarks `a` and `b`; 0 where the stream lacks one."""
    if not (present[a] and present[b]):
        return 0.0
    d = 0.0
    for x in range(3):
        d += (mean[a, x] - mean[b, x]) ** 2
    return math.sqrt(d)


@kernel
def trunk_length(mean: Samples, present: Array) -> float:
    """From the middle of the hips to that of the shoulders; 0 where the stream lacks one."""
    d = 0.0
    for x in range(3):
        d += (0.5 * (mean[HIP_AT, x] + mean[HIP_AT + 1, x] - mean[SHOULDER_AT, x] - mean[SHOULDER_AT + 1, x])) ** 2
    both = present[HIP_AT] and present[HIP_AT + 1] and present[SHOULDER_AT] and present[SHOULDER_AT + 1]
    return math.sqrt(d) if both else 0.0


@kernel
def scale_body(mean: Samples, present: Array, usual: Samples, offsets: Samples) -> float:
    """Give the skeleton `offsets` (22, 3) the bone lengths of someone who stands with landmarks `mean` (m, 3); returns the body's size.

    Left and right get the same lengths. What the markers do not show has the size of what they show; 1 is that of `usual` (22, 3).
    """
    thigh, shank = apart(mean, present, HIP_AT, KNEE_AT), apart(mean, present, KNEE_AT, ANKLE_AT)
    upper, lower = apart(mean, present, SHOULDER_AT, ELBOW_AT), apart(mean, present, ELBOW_AT, WRIST_AT)
    leg, arm = apart(mean, present, HIP_AT, ANKLE_AT), apart(mean, present, SHOULDER_AT, WRIST_AT)
    rate = _rates(usual)
    total = scale = 0.0
    lengths = (thigh, shank, upper, lower, trunk_length(mean, present))
    if thigh == 0.0 and leg > 0.0:
        share = leg / (rate[0] + rate[1])
        lengths = (share * rate[0], share * rate[1], lengths[2], lengths[3], lengths[4])
    if upper == 0.0 and arm > 0.0:
        share = arm / (rate[2] + rate[3])
        lengths = (lengths[0], lengths[1], share * rate[2], share * rate[3], lengths[4])
    for k in range(5):
        if lengths[k] > 0.0:
            total += lengths[k]
            scale += rate[k]
    size = total / scale if scale > 0.0 else 1.0
    factors = (
        lengths[0] / rate[0],
        lengths[1] / rate[1],
        lengths[2] / rate[2],
        lengths[3] / rate[3],
        lengths[4] / rate[4],
    )
    hips = across(mean, present, HIP_AT, HIP_AT + 1) / (2.0 * abs(usual[14, 0]))
    shoulders = across(mean, present, SHOULDER_AT, SHOULDER_AT + 1) / (2.0 * abs(usual[6, 0] + usual[7, 0]))
    offsets[:] = size * usual
    for side in range(2):
        _stretch(usual, offsets, 15 + 4 * side, factors[0])
        _stretch(usual, offsets, 16 + 4 * side, factors[1])
        _stretch(usual, offsets, 8 + 4 * side, factors[2])
        _stretch(usual, offsets, 9 + 4 * side, factors[3])
        _stretch(usual, offsets, 14 + 4 * side, hips)
        _stretch(usual, offsets, 6 + 4 * side, factors[4])
        _stretch(usual, offsets, 7 + 4 * side, shoulders)
    for bone in range(1, 5):
        _stretch(usual, offsets, bone, factors[4])
    return size


@kernel
def _rates(usual: Samples) -> tuple[float, float, float, float, float]:
    """Lengths of thigh, shank, upper arm, lower arm and trunk of the usual body."""
    trunk = usual[1, 1] + usual[2, 1] + usual[3, 1] + usual[6, 1] + usual[7, 1] - usual[14, 1]
    lengths = (15, 16, 8, 9)
    made = [0.0, 0.0, 0.0, 0.0]
    for i in range(4):
        b = lengths[i]
        made[i] = math.sqrt(usual[b, 0] ** 2 + usual[b, 1] ** 2 + usual[b, 2] ** 2)
    return made[0], made[1], made[2], made[3], trunk


@kernel
def _stretch(usual: Samples, offsets: Samples, bone: int, factor: float) -> None:
    """Make a bone's offset `factor` times the usual one, where that is known and within reason."""
    if 0.4 < factor < 2.5:
        for a in range(3):
            offsets[bone, a] = factor * usual[bone, a]
