"""The house: architecture, words, docs, the wheel, what a stranger finds."""
