"""The drop-in contract: what code written for ``filterpy.kalman.KalmanFilter`` may rely on."""
