"""Steps of a person who wears one inertial sensor: where they are, what they are like, what they tell (thesis, chapter 7)."""
