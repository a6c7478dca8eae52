"""What training needs besides the network, one model in one file: batches, loss, validation error, export."""
