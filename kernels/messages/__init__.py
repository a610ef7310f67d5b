"""From likelihood to update: gating, evaluation, association, existence."""
