"""Fast sensor for simulations: cycles of a rangefinder on a tube, from contacts.

Reading order: `tables` (scattering of tools over depth, refined from a library), `network` (the
echo of contacts joined by straight tube, in JAX), `cycles` (the voltage that it makes), `assembly`
(what these need of a rangefinder and a tube), `contacts` and `tube_sensor` (contacts in, cycles
out); `environment` for reinforcement learning.
"""

from acoustube.sensor.contacts import Contact
from acoustube.sensor.tube_sensor import TubeSensor

__all__ = ["Contact", "TubeSensor"]
