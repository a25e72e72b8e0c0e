"""Set how the process behaves: threads of BLAS and OpenCV, Ctrl-C, and the times of frames."""
