"""Objects, from trees to machines, as functions that add one to a scene.

`foot` is the middle of an object's base.
"""

from anynet.synthetic.objects.lattices import machine, shelf, slats
from anynet.synthetic.objects.plants import bush, plant, tree
from anynet.synthetic.objects.street import car, person, sign
from anynet.synthetic.objects.thing import thing

__all__ = ["bush", "car", "machine", "person", "plant", "shelf", "sign", "slats", "thing", "tree"]
