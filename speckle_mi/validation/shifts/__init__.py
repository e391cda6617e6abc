"""The shift measurement beside public programs, on the same exactly shifted speckle, in one run."""
