"""cmake/compatibility.cpp goes with any compiler's library."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "cmake" / "compatibility.cpp"
USER = """
#include <sstream>
long elements(long count) {
  std::ostringstream text;
  text << count;
  return count + long(text.str().size()) + *new int[count]();
}
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@pytest.mark.skipif(not SOURCE.exists(), reason="the sources are not here")
@pytest.mark.parametrize("libraries", [[], ["-static-libstdc++"]])
def test_links_with_the_compilers_library_as_a_file_or_an_archive(tmp_path: Path, libraries: list[str]) -> None:
    (tmp_path / "user.cpp").write_text(USER)
    library = tmp_path / "library.so"
    options = ["-std=c++17", "-fPIC", "-shared", "-fvisibility=hidden"]
    subprocess.run(["g++", *options, SOURCE, tmp_path / "user.cpp", *libraries, "-o", library], check=True)
    assert library.exists()
