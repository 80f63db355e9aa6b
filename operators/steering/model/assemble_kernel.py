"""A mesh put together from its parts, a sample in one piece of compiled code."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel


@kernel
def gather_marks(
    row: Samples,
    columns: Times,
    scale: Samples,
    reference: Times,
    facing: Samples,
    known: Array,
    marks: Samples,
    centre: Samples,
    heading: Samples,
    x: Samples,
) -> bool:
    """Markers (m, 3) of a sample `row` into `marks`, and as seen from the references' mean, `centre` (3,), into `x` (3 m,).

    Where `facing` (4,) names two markers and a direction, they are turned back by the `heading` (2,), its cosine and sine. One that is not
    seen has moved with the reference since it was. Returns whether every marker has been seen at least once.
    """
    n = 0
    before = centre.copy()
    centre[:] = 0.0
    for r in range(reference.shape[0]):
        c = columns[reference[r]]
        v = row[c[0]] + row[c[1]] + row[c[2]]
        if v == v:
            n += 1
            for a in range(3):
                centre[a] += scale[a] * row[c[a]]
    for a in range(3):
        centre[a] = centre[a] / n if n == reference.shape[0] else before[a]
    if facing.shape[0] == 4:
        face(row, columns[int(facing[0])], columns[int(facing[1])], scale, facing[2], facing[3], heading)
    whole = True
    for k in range(columns.shape[0]):
        c = columns[k]
        v = row[c[0]] + row[c[1]] + row[c[2]]
        if v == v:
            known[k] = True
            for a in range(3):
                marks[k, a] = scale[a] * row[c[a]] - centre[a]
            if facing.shape[0] == 4:
                p, q = marks[k, 0], marks[k, 2]
                marks[k, 0] = heading[0] * p - heading[1] * q
                marks[k, 2] = heading[0] * q + heading[1] * p
        whole = whole and known[k]
        for a in range(3):
            x[3 * k + a] = marks[k, a]
    return whole


@kernel
def face(
    row: Samples, start: Times, end: Times, scale: Samples, ahead_x: float, ahead_z: float, heading: Samples
) -> None:
    """How far the markers from `start` to `end` (columns of `row`) are turned from a direction: cosine and sine into `heading` (2,).

    It stays where they are not seen, or stand one above the other.
    """
    a = math.copysign(1.0, scale[0]) * (row[end[0]] - row[start[0]])
    b = math.copysign(1.0, scale[2]) * (row[end[2]] - row[start[2]])
    c, s = ahead_x * a + ahead_z * b, ahead_z * a - ahead_x * b
    n = math.sqrt(c * c + s * s)
    if n > 1e-9:
        heading[0], heading[1] = c / n, s / n


@kernel
def put(centre: Samples, heading: Samples, reach: float, out: Samples) -> None:
    """The mesh `out` (v, 3) turned by `heading` about the vertical and moved to `centre` (3,), `reach` times as far."""
    for v in range(out.shape[0]):
        p, q = out[v, 0], out[v, 2]
        out[v, 0] = heading[0] * p + heading[1] * q + reach * centre[0]
        out[v, 1] += reach * centre[1]
        out[v, 2] = heading[0] * q - heading[1] * p + reach * centre[2]


@kernel
def apart(x: Samples, features: Times, centre: Samples) -> float:
    """The squared distance of `x` from a frame of the training, `centre` (f,), in the `features` of `x`."""
    d = 0.0
    for k in range(features.shape[0]):
        e = x[features[k]] - centre[k]
        d += e * e
    return d


@kernel
def predict(
    x: Samples, features: Times, centres: Samples, weights: Samples, mean: Samples, scale: float, out: Samples
) -> float:
    """Kernel regression of one part: `out` (q,) = mean + sum over f of exp(-scale |x - centres[f]|^2) weights[f].

    Of `x` it goes by `features`. Returns how far the nearest frame of the training is, in kernel widths.
    """
    out[:] = mean
    least = math.inf
    for f in range(centres.shape[0]):
        d = apart(x, features, centres[f])
        least = min(least, d)
        g = math.exp(-scale * d)
        for q in range(out.shape[0]):
            out[q] += g * weights[f, q]
    return math.sqrt(2.0 * scale * least)


@kernel
def predict_linear(
    x: Samples,
    features: Times,
    centres: Samples,
    middle: Samples,
    weights: Samples,
    mean: Samples,
    scale: float,
    furthest: float,
    out: Samples,
) -> float:
    """Linear regression of one part: `out` (q,) = mean + (x - middle) weights, of which `x` is held back `furthest` widths from the frames.

    Returns how far the nearest frame of the training is, in kernel widths; `scale` is that of a kernel, negative.
    """
    least = math.inf
    for f in range(centres.shape[0]):
        least = min(least, apart(x, features, centres[f]))
    far = math.sqrt(-2.0 * scale * least)
    share = min(1.0, furthest / max(far, 1e-12))
    out[:] = mean
    for k in range(features.shape[0]):
        g = share * (x[features[k]] - middle[k])
        for q in range(out.shape[0]):
            out[q] += g * weights[k, q]
    return far


@kernel
def add_part(
    y: Samples, vertices: Times, share: Samples, mean: Samples, modes: Samples, turn: Samples, out: Samples
) -> None:
    """Add a part, as its prediction `y` (9 + modes,) says, to the vertices `out` (v, 3). `turn` (3, 3) is room.

    y is a rotation by two columns, a translation, and a coefficient for each of `modes` (k, n, 3)
    """
    columns(y, turn)
    spread = math.sqrt(vertices.shape[0])
    for i in range(vertices.shape[0]):
        p, q, r = mean[i, 0], mean[i, 1], mean[i, 2]
        for m in range(modes.shape[0]):
            s = spread * y[9 + m]
            p += s * modes[m, i, 0]
            q += s * modes[m, i, 1]
            r += s * modes[m, i, 2]
        w, v = share[i], vertices[i]
        for a in range(3):
            out[v, a] += w * (turn[a, 0] * p + turn[a, 1] * q + turn[a, 2] * r + y[6 + a])


@kernel
def columns(y: Samples, turn: Samples) -> None:
    """The rotation matrix (3, 3) nearest to two columns, y[:6]."""
    n = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    for a in range(3):
        turn[a, 0] = y[a] / max(n, 1e-12)
    d = y[3] * turn[0, 0] + y[4] * turn[1, 0] + y[5] * turn[2, 0]
    n = 0.0
    for a in range(3):
        turn[a, 1] = y[3 + a] - d * turn[a, 0]
        n += turn[a, 1] * turn[a, 1]
    n = max(math.sqrt(n), 1e-12)
    for a in range(3):
        turn[a, 1] /= n
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        turn[a, 2] = turn[b, 0] * turn[c, 1] - turn[c, 0] * turn[b, 1]
