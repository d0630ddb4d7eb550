"""What several scripts share: reports, pictures, recorded data, the protocol of draws and their evaluation."""
