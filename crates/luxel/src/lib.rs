//! Luxel for programs: data sets, training, rendering, editing and export of scenes in scene-linear radiance.
