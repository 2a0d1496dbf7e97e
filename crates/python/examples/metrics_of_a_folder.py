"""Measures the images of a folder against references of the same names, as CSV.

    python metrics_of_a_folder.py REFERENCES IMAGES
"""

from __future__ import annotations

import csv
import sys

from luxel import metrics

COLUMNS = ["name", "psnr_scene", "psnr_gtmax", "ssim_gtmax", "pu21_psnr", "log_rmse", "hdr_flip"]


def main(references: str, images: str) -> None:
    found = metrics.compare_files(references, images)
    table = csv.DictWriter(sys.stdout, COLUMNS, extrasaction="ignore")
    table.writeheader()
    table.writerows(found["images"])
    table.writerow({"name": "mean", **found["mean"]})


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
