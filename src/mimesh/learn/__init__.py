"""Everything that needs torch (the [train] extra): models, losses, data on the device, training and export."""
