"""Other programs' formats, in and out: importers make recordings of them, exporters write them from recordings."""
