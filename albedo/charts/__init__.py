"""Charts: maps from the unit square to outgoing directions, where a lobe is wide and smooth.

A chart splits the hemisphere into *panels*, on each of which the integrand is smooth, and maps a
panel to directions with its Jacobian. Charts know kinks, horizons and scales, and nothing of the
formula that is integrated; integrators know panels, and nothing of directions.
"""
