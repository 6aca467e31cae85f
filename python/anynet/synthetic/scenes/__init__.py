"""Random scenes: streets, rooms, open ground, and heaps of things in the air.

Object sizes follow a scene's `unit`, about 0.54 m (KITTI's baseline) in streets.
"""

from collections.abc import Callable

from anynet.synthetic.scene import Scene
from anynet.synthetic.scenes.ground import ground
from anynet.synthetic.scenes.room import room
from anynet.synthetic.scenes.street import street
from anynet.synthetic.scenes.things import things
from anynet.synthetic.textures import Rng

PRESETS: dict[str, Callable[[Rng, int, int], Scene]] = {
    "street": street,
    "room": room,
    "ground": ground,
    "things": things,
}
