"""Still pictures of a target whose place is known exactly, with every trouble that a real camera adds.

`stadimeter.simulation.camera` draws a live view and must keep up with it. Here accuracy comes first: these pictures
are what detectors are tuned on and judged by. A `support.scenes.scene.Scene` holds all parameters, and
`support.scenes.render.render` makes a picture and its truth from it. The same scene always gives the
same picture.

How light becomes a picture, step by step, and where:

1. `lens`: each sample of a pixel looks along a ray; distortion and the rolling shutter bend it.
2. `ball`, `plane`: the ray is intersected with the sphere or the plane; the edge is anti-aliased exactly.
3. `backdrop`, `occluder`: what lies behind and before the target.
4. `blur`: motion and the point spread of the lens, in linear light, on the samples. Only then are they averaged to
   pixels.
5. `sensor`: exposure, tone curve, sharpening, noise and JPEG, as a camera does them, in this order.

`draw` makes random scenes of the kinds that the benchmarks measure, and `nuisances` lists the troubles.
"""
