"""The variational autoencoder of depth windows: model, loss and data."""
