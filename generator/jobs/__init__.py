"""Many processes and none of them Blender's own: sweeps, bulk sets, their journal, budget and cluster."""
