"""The variational autoencoder of depth windows: model, loss, data and quality."""
