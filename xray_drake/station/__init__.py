"""The bin station: plant, camera, and the scenario that fills them."""
