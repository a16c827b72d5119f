"""Turn a camera into a rangefinder that acts.

A stadimeter is the navigator's instrument that measures distance from an object's known height. This package does
the same with a camera: it finds an object of known size, measures how far away it is, says how sure it is, and lets
rules turn that into action.
"""

__version__ = "0.1.0"
