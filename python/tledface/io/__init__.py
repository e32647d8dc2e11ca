"""Files in and out: the model file, time series for ParaView, surfaces for other tools."""
