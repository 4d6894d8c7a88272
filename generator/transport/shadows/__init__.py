"""The object's shadows on the room, cut exactly: cones, pieces of polygons, and the light on them."""
