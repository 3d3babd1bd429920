"""Where the bytes of photographs and artefacts are kept: one contract (blob_store.py), a file a kind of store."""
