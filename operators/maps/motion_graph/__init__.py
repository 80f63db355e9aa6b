"""Motion graphs: from recorded poses and their primitives to a graph that new motion is walked on (thesis, chapter 10)."""
