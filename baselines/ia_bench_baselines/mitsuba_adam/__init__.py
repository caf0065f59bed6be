"""A plain loop of Mitsuba 3 and Adam."""
