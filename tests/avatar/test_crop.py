"""Points of the network, moved to the middle of the heat around them: also where that lies at the picture's edge."""

from __future__ import annotations
