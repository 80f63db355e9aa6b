"""Files of wearables and boards: ActiGraph, Actiwatch, MotionWatch, Axivity, GENEActiv, OpenSignals.

Each was written from its maker's public description and tried on imitations of it only, which every import says.
"""

UNTRIED = "this reader follows the format's public description and was never tried on a real recording: compare it with the maker's program"
