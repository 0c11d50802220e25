"""FMUs that others made: the archive, the description in it, and the binary that fits this machine.

x.fmu --archive--> names and bytes --description--> Description        nothing is unpacked or loaded
        archive.unpack(x.fmu) --> a private folder --library--> ctypes.CDLL
"""
