"""Set how the process behaves: threads of linear algebra, Ctrl-C, and the times of frames."""
