"""`python -m physkin_core.loader.loading_process`: the process that loads, begun by `AssetLoader`."""

from __future__ import annotations

from importlib import import_module

from physkin_core.avatar.body_model import load_body_model
from physkin_core.loader.loading import Loading
from physkin_core.worker.serving import serve

LOADERS = ("scipy.sparse.csgraph", "scipy.sparse.linalg", "scipy.spatial", "point_cloud_utils")
"""What readers and fitting import where they need it: at once, so that the first body does not wait for it."""

if __name__ == "__main__":
    for loader in LOADERS:
        import_module(loader)
    load_body_model()
    serve(Loading())
