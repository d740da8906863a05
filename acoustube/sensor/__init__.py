"""Fast simulation of a sensor: cycles of a rangefinder on a tube, from contacts.

Reading order: `tables` (scattering of tools over depth, refined from a library), `network` (echo of
contacts joined by straight tube, in JAX), `cycles` (voltage of that echo), `assembly` (constant
arrays of a rangefinder and a tube), `wrapped` (those of a wrapped tube), `contacts` and
`tube_sensor` (contacts in, cycles out), and `environment` (for reinforcement learning).
"""

from acoustube.sensor.contacts import Contact
from acoustube.sensor.tube_sensor import TubeSensor

__all__ = ["Contact", "TubeSensor"]
