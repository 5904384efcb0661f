"""Pictures: charts, films, plans."""
