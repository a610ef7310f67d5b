"""A method of your own: a Kalman filter on lines of sight, planar (no heights), for one room. No map.

    gridslam run room --method own_method:SightFilter            (from this folder)
    gridslam study room --runs 5 --method grid --method own_method:SightFilter -o compare

In Python: ``gs.map_scene(scene, heard, SightFilter)``. `gs.Slam` says what a method needs.
"""

import numpy as np

import gridslam as gs

GATE = 16.3  # squared Mahalanobis distance that one line of sight in 1000 exceeds (chi-square, 3 degrees)


class SightFilter:
    """Follows [x, y, vx, vy, heading] (m, m/s, rad) by distance, AoD and AoA of each anchor's direct path."""

    def __init__(self, scene, prior_map=None, agent=None, seed=0):
        self.model = scene.filter_model(agent)  # what a filter may know of a scene: no walls, no true track
        self.agent, self.time_s = self.model.agent, None
        self.known_map = gs.Map.of_scene(scene) if prior_map is None else prior_map
        self.mean, self.covariance = self.model.start_mean.copy(), np.diag(self.model.start_variance)

    def step(self, scan):
        """Predict (nearly constant velocity), take in what was heard of each anchor, say what is believed."""
        dt, self.time_s = 0.0 if self.time_s is None else scan.time_s - self.time_s, scan.time_s
        settings, motion = self.model.settings, np.eye(5) + dt * np.eye(5, k=2) * [0, 0, 1, 1, 0]
        push = np.array([[dt**2 / 2, 0, dt, 0, 0], [0, dt**2 / 2, 0, dt, 0], [0, 0, 0, 0, dt > 0]])
        spreads = [settings.acceleration_mps2] * 2 + [np.radians(settings.heading_deg)]
        noise = push.T * np.square(spreads) @ push
        self.mean, self.covariance = motion @ self.mean, motion @ self.covariance @ motion.T + noise
        for anchor in range(len(self.model.anchors)):
            self.update(anchor, scan)
        return gs.Estimate.of_pose(scan, self.mean[:2], self.mean[4], self.covariance, self.mean[2:4])

    def map(self):
        """The map that it was given, or a blank one."""
        return self.known_map

    def update(self, anchor, scan):
        """Kalman update by the measurement that fits an anchor's line of sight best, if any does."""
        (x, y, facing), radio = self.model.anchors[anchor], self.model.radio
        dx, dy = self.mean[0] - x, self.mean[1] - y
        d, bearing = np.hypot(dx, dy), np.arctan2(dy, dx)
        aod, aoa = bearing - facing, bearing + np.pi - self.mean[4]
        across = np.array([-dy, dx, 0, 0, 0]) / d**2  # slope of the bearing
        slopes = np.array([[dx / d, dy / d, 0, 0, 0], across, across - [0, 0, 0, 0, 1]])
        u, arrays = radio.amplitude(d), (radio.anchor_aperture[anchor], radio.agent_aperture)
        errors = np.diag([radio.distance_std(u), *map(radio.angle_std, (u, u), (aod, aoa), arrays)]) ** 2
        spread = slopes @ self.covariance @ slopes.T + errors  # singular, by rounding, where it is kilometres
        measured = np.column_stack([scan.distance_m, scan.aod_rad, scan.aoa_rad])[scan.anchor == anchor]
        off = measured - [d, aod, aoa]
        off[:, 1:] = (off[:, 1:] + np.pi) % (2 * np.pi) - np.pi
        misfit = np.einsum("mi,ij,mj->m", off, np.linalg.pinv(spread), off)
        if (misfit < GATE).any():  # never of NaN, which stands for an angle that wasn't measured
            gain = self.covariance @ slopes.T @ np.linalg.pinv(spread)
            self.mean = self.mean + gain @ off[np.nanargmin(misfit)]
            left = np.eye(5) - gain @ slopes  # Joseph's form: rounding leaves no negative variance
            self.covariance = left @ self.covariance @ left.T + gain @ errors @ gain.T
