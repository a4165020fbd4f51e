"""Code written for filterpy, run with UFIRFilter in the place of KalmanFilter."""
