"""Files and programs of others: URDF, MJCF, MuJoCo, ONNX and Minari."""
