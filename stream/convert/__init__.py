"""Other people's files in and out: CSV, NPZ and XDF become recordings, and recordings become CSV and XDF."""
