"""Put what `physkin export --web` copies beside the native module of this Python's installation."""

import shutil
import sys

from physkin_core.export.web_page import PAGE

shutil.copytree(sys.argv[1], PAGE, dirs_exist_ok=True)
print(f"the page's files are in {PAGE}")
