"""Messages of a step: motion, prediction, likelihood, association, updates, births, cells, coefficients."""
