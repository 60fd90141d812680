namespace bundle {}
