"""The numbers that the papers print, as they print them."""

from __future__ import annotations

# Zhou, Li, Xiao, He, Huang, Li: "Auto-conditioned recurrent networks for extended complex human motion synthesis",
# ICLR 2018. Euclidean distance to the truth at 80, 160, 240, 320, 400, 480, 560 and 640 ms after a seed of ten
# frames, mean of 20 seeds from the test set.
ACRNN_TABLE_1: dict[str, dict[str, tuple[float, ...]]] = {
    "walking": {
        "lstm": (2.46, 2.41, 2.28, 2.27, 2.41, 2.65, 2.91, 3.15),
        "aclstm": (1.05, 1.77, 2.20, 2.46, 2.66, 2.79, 2.99, 3.24),
        "erd": (0.13, 0.22, 0.34, 0.50, 0.71, 0.95, 1.19, 1.42),
        "seq2seq": (0.09, 0.13, 0.24, 0.42, 0.74, 1.22, 1.85, 2.79),
        "scheduled-sampling": (0.42, 0.56, 0.71, 0.83, 0.93, 0.99, 1.02, 1.05),
    },
    "indian": {
        "lstm": (2.82, 2.83, 2.85, 2.88, 2.89, 2.90, 2.92, 2.92),
        "aclstm": (0.685, 0.99, 1.22, 1.53, 1.89, 2.08, 2.27, 2.55),
        "erd": (0.51, 0.74, 1.25, 1.96, 2.62, 3.31, 3.76, 3.86),
        "seq2seq": (0.49, 0.79, 1.48, 2.95, 5.41, 8.88, 13.29, 18.73),
        "scheduled-sampling": (1.54, 2.24, 2.49, 2.52, 2.65, 2.90, 2.94, 3.12),
    },
    "martial": {
        "lstm": (0.69, 0.86, 1.11, 1.36, 1.60, 1.83, 2.03, 2.19),
        "aclstm": (0.52, 0.74, 0.95, 1.14, 1.35, 1.56, 1.73, 1.88),
        "erd": (0.32, 0.44, 0.63, 0.90, 1.14, 1.40, 1.61, 1.88),
        "seq2seq": (0.28, 0.43, 0.87, 1.57, 2.53, 3.89, 5.83, 8.62),
        "scheduled-sampling": (0.63, 0.86, 0.91, 0.98, 1.07, 1.12, 1.20, 1.28),
    },
}
# Table 2, of the appendix: Indian dance, by condition length (u = v).
ACRNN_TABLE_2: dict[str, tuple[float, ...]] = {
    "aclstm-u10-v10": (0.41, 0.52, 0.68, 0.86, 1.04, 1.23, 1.39, 1.55),
    "aclstm": (0.685, 0.99, 1.22, 1.53, 1.89, 2.08, 2.27, 2.55),
    "aclstm-u2-v2": (0.83, 1.28, 1.61, 1.87, 2.09, 2.31, 2.51, 2.66),
    "aclstm-u1-v1": (0.89, 1.40, 1.78, 2.14, 2.48, 2.70, 2.84, 2.93),
    "scheduled-sampling": (1.54, 2.24, 2.49, 2.52, 2.65, 2.90, 2.94, 3.12),
}

# Habibie, Holden, Schwarz, Yearsley, Komura: "A recurrent variational autoencoder for human motion synthesis", BMVC
# 2017. Mean squared error of joint positions, in a unit that the paper does not tell, mean of 20 test sequences, at
# these frames of clips of 240 frames at 60 Hz.
VAE_LSTM_FRAMES: tuple[int, ...] = (70, 90, 120, 160, 210)
# Table 1, motion error: the baselines see 60 frames and predict the control signal themselves, the VAE-LSTM is given it
# and sees 4 frames, or none where the code is a sample from the prior.
VAE_LSTM_TABLE_1: dict[str, tuple[float, ...]] = {
    "erd": (0.66, 2.10, 6.13, 13.53, 19.49),
    "lstm": (0.55, 3.18, 9.47, 14.14, 17.98),
    "crbm-cd1": (1.41, 3.51, 7.96, 11.51, 15.77),
    "crbm-cd15": (1.41, 3.71, 8.28, 10.54, 15.79),
    "vae-lstm": (1.45, 1.75, 2.20, 3.25, 4.12),
    "vae-lstm-prior": (1.97, 2.37, 2.91, 3.97, 4.91),
}
# Table 2, pose error, relative to the root: all are given the true control and see 4 frames, the prior sample none.
VAE_LSTM_TABLE_2: dict[str, tuple[float, ...]] = {
    "erd": (2.31, 2.62, 2.54, 2.99, 2.63),
    "lstm": (2.11, 2.15, 2.36, 2.34, 2.17),
    "crbm-cd1": (2.76, 2.81, 3.13, 2.82, 3.01),
    "crbm-cd15": (2.64, 2.71, 3.08, 2.85, 3.21),
    "vae-lstm": (0.82, 0.85, 0.82, 0.83, 0.87),
    "vae-lstm-prior": (1.23, 1.27, 1.24, 1.24, 1.29),
}
