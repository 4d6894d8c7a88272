"""The engines that render pictures: two by Cycles and `surfel`, and the reading of the scene that they share."""
