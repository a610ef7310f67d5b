"""What a file is, and what is wrong with its units, frames or clocks.

Files of a folder import from their own folder and from those above it in this table alone.

============  =======================================================================================
folder        what its files tell
============  =======================================================================================
`tables`      what numbers alone give away: units, fillers, rows written twice
`scene`       what a scene holds, leaves in sight and allows for; how distances may be off from it
`sights`      which rows are lines of sight (`line_of_sight_filter`), and where they put the agent
`columns`     what single columns may have been meant as: deviations, elevations, amplitudes, times
`anchors`     what may be wrong with anchors: distances, heights, names, turns, places
`starts`      where an agent began and which way it looks, and whether a filter only lost it
`verdicts`    all of these weighed against each other, and what is said of a table (`diagnose`)
`network`     tables of several agents: labels, clocks, each agent's rows
`signals`     files of sampled signals
`runs`        what is said after a run
`files`       files that runs, exports and studies leave
============  =======================================================================================

Where a function takes a `table` or `columns`, they are a dict of arrays (K,), one entry a row: names and
units as of `gridslam.world.columns`, NaN where nothing was measured, `anchor` a place in the scene's anchors.
Most want rows in the order of steps, and say so.
"""
