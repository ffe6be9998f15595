"""glTF 2.0: binary .glb, and .gltf with embedded buffers or the files beside it."""
