"""What the numbers of a table alone give away: units, fillers, rows written twice."""
