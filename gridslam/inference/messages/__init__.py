"""The messages of a step, in the papers' order: prediction, likelihood, association, update, cells."""
