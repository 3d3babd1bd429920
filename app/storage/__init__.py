"""Storage of photographs and artefacts: one contract (blob_store.py), one file per kind of store."""
