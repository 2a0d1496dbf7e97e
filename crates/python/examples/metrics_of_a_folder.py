"""Measures the images of a folder against references of the same names, as CSV.

    python metrics_of_a_folder.py REFERENCES IMAGES
"""

# %% parameters references = "references", images = "renders"
from __future__ import annotations

import csv
import sys

from luxel import metrics

if len(sys.argv) != 3:
    sys.exit(__doc__)
references, images = sys.argv[1:]

# %% text
# Both folders hold HDR images. PU21 and HDR-FLIP follow what people see on a display, `psnr_scene` compares
# radiance under the mu-law, and `log_rmse` its logarithm.

# %%
found = metrics.compare_files(references, images)

# %%
columns = ["name", "psnr_scene", "psnr_gtmax", "ssim_gtmax", "pu21_psnr", "log_rmse", "hdr_flip"]
table = csv.DictWriter(sys.stdout, columns, extrasaction="ignore")
table.writeheader()
table.writerows(found["images"])
table.writerow({"name": "mean", **found["mean"]})
