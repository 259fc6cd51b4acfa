"""The plant model beside the rig: its residual, the band it belongs in, and the test that says when it leaves."""
