#!/bin/sh
# Derives tests/data again from the public packages named in SOURCES.md and compares every file's sha256.
# Usage: tests/data/derive.sh DIR     (DIR is made if missing; needs apt-get, dpkg-deb, pip, unzip, sha256sum)
# Exit: 0 all files equal, 1 a file differs or is missing, 2 wrong use or a package could not be had.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
opencv_doc=4.6.0+dfsg-12
scikit_image=0.26.0

say() { printf '%s\n' "derive.sh: $*" >&2; }
[ $# -eq 1 ] || { say "give one folder to write to: derive.sh DIR"; exit 2; }
for tool in apt-get dpkg-deb pip unzip sha256sum; do
    command -v "$tool" >/dev/null || { say "$tool is missing: install it and run again"; exit 2; }
done
mkdir -p "$1/chessboard"
out=$(cd "$1" && pwd)
[ "$out" != "$here" ] || { say "DIR is tests/data itself: give another folder, so that the files can be compared"; exit 2; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

apt-get download -q "opencv-doc=$opencv_doc" >/dev/null 2>"$work/apt" || {
    say "apt has no opencv-doc $opencv_doc: run 'apt-get update' first; this version is Debian 12's"
    cat "$work/apt" >&2
    exit 2
}
dpkg-deb -x opencv-doc_*.deb opencv
# The wheel's files do not depend on the platform; naming one lets any Python's pip take it.
pip download -q --no-deps --only-binary=:all: --python-version 3.11 --platform manylinux_2_28_x86_64 \
    --platform manylinux_2_24_x86_64 "scikit-image==$scikit_image" || {
    say "pip could not download scikit-image $scikit_image"
    exit 2
}
unzip -q scikit_image-*.whl 'skimage/data/retina.jpg'

for n in 01 02 03 04 05 06 07 08 09 11 12 13 14; do
    for side in left right; do
        from=opencv/usr/share/doc/opencv-doc/examples/data/$side$n.jpg
        # Debian compresses big files of a doc package; which ones depends on its version.
        if [ -f "$from.gz" ]; then gunzip -c "$from.gz" >"$out/chessboard/$side$n.jpg"; else cp "$from" "$out/chessboard/"; fi
    done
done
cp skimage/data/retina.jpg "$out/"

cd "$out"
grep -E '^[0-9a-f]{64}  ' "$here/SOURCES.md" >"$work/sums"
if sha256sum --quiet -c "$work/sums"; then
    say "$(wc -l <"$work/sums") files equal those in SOURCES.md"
else
    say "the files named above differ from SOURCES.md"
    exit 1
fi
