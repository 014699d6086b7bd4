"""Leaves and bark of sixteen kinds of trees, for tests and pictures."""

from species.barkart import BarkShape
from species.leafart import LeafColors, LeafShape

LEAF = {
    "mahogany": LeafShape(
        "pinnate", length=0.26, leaflets=8, leaflet_length=0.115, leaflet_width=0.042, leaflet_angle_deg=58,
        taper=0.2, widest=0.38, tip=0.62, base=0.1, drip=0.08, bend=0.1, petiole=0.05, stalk_width=0.0025,
        veins=9, vein_angle_deg=58, midrib=0.05, fold_deg=12, curl_deg=20,
    ),
    "bischofia": LeafShape(
        "palmate", length=0.15, leaflets=3, leaflet_length=0.115, leaflet_width=0.068, spread_deg=150,
        taper=0.12, widest=0.42, tip=0.45, base=0.08, drip=0.13, margin="crenate", teeth=26,
        tooth_depth=0.06, petiole=0.1, stalk_width=0.0024, veins=7, vein_angle_deg=52, midrib=0.04,
        fold_deg=15, curl_deg=30,
    ),
    "delonix": LeafShape(
        "bipinnate", length=0.40, width=0.20, pinnae=14, leaflets=40, leaflet_length=0.0125,
        leaflet_width=0.0042, leaflet_angle_deg=68, taper=0.35, widest=0.5, tip=0.1, base=0.1, petiole=0.06,
        stalk_width=0.003, veins=0, midrib=0.08, fold_deg=0, curl_deg=35,
    ),
    "lagerstroemia": LeafShape(
        "simple", length=0.06, width=0.036, widest=0.5, tip=0.4, base=0.25, petiole=0.003,
        stalk_width=0.0012, veins=7, vein_angle_deg=55, midrib=0.045, fold_deg=15, curl_deg=20,
    ),
    "ailanthus": LeafShape(
        "pinnate", length=0.55, leaflets=23, leaflet_length=0.135, leaflet_width=0.044, leaflet_angle_deg=76,
        taper=0.3, widest=0.25, tip=0.66, base=0.0, drip=0.08, bend=0.06, petiole=0.08, stalk_width=0.004,
        veins=10, vein_angle_deg=60, midrib=0.05, fold_deg=8, curl_deg=40,
    ),
    "palm": LeafShape(
        "frond", length=3.6, leaflets=105, leaflet_length=0.8, leaflet_width=0.05, leaflet_angle_deg=72,
        taper=0.75, tip=0.75, base=0.1, petiole=0.7, stalk_width=0.07, veins=0, midrib=0.12, bend=0.04,
        fold_deg=25, curl_deg=80,
    ),
    "terminalia": LeafShape(
        "simple", length=0.22, width=0.125, widest=0.68, tip=0.05, base=0.42, drip=0.025, petiole=0.014,
        stalk_width=0.004, veins=9, vein_angle_deg=62, midrib=0.035, fold_deg=10, curl_deg=25,
    ),
    "pine": LeafShape(
        "needle", length=0.15, leaflets=44, cluster=2, leaflet_length=0.068, leaflet_width=0.0016,
        leaflet_angle_deg=52, spread_deg=9, taper=0.2, tip=0.25, base=0.0, petiole=0.012, stalk_width=0.005,
        veins=0, midrib=0.0, bend=0.03, fold_deg=0, curl_deg=0,
    ),
    "ficus virens": LeafShape(
        "simple", length=0.15, width=0.062, widest=0.42, tip=0.35, base=0.06, drip=0.14, petiole=0.05,
        stalk_width=0.002, veins=9, vein_angle_deg=62, midrib=0.04, fold_deg=12, curl_deg=25,
    ),
    "willow": LeafShape(
        "linear", length=0.13, width=0.0145, tip=0.85, base=0.5, margin="serrate", teeth=45,
        tooth_depth=0.08, bend=0.06, petiole=0.006, stalk_width=0.0012, veins=16, vein_angle_deg=48,
        midrib=0.09, fold_deg=15, curl_deg=50,
    ),
    "ficus benjamina": LeafShape(
        "simple", length=0.085, width=0.037, widest=0.4, tip=0.5, base=0.12, drip=0.13, petiole=0.014,
        stalk_width=0.0014, veins=15, vein_angle_deg=72,
        midrib=0.035, fold_deg=25, curl_deg=40,
    ),
    "ficus microcarpa": LeafShape(
        "simple", length=0.06, width=0.032, widest=0.52, tip=0.22, base=0.4, drip=0.03, petiole=0.011,
        stalk_width=0.0013, veins=7, vein_angle_deg=58, midrib=0.04, fold_deg=20, curl_deg=20,
    ),
    "oak": LeafShape(
        "lobed", length=0.11, width=0.068, widest=0.6, tip=0.12, base=0.5, lobes=4, lobe_depth=0.46,
        petiole=0.005, stalk_width=0.0018, veins=4, vein_angle_deg=42, midrib=0.04, fold_deg=10, curl_deg=15,
    ),
    "beech": LeafShape(
        "simple", length=0.08, width=0.053, widest=0.47, tip=0.32, base=0.15, drip=0.03, margin="wavy",
        teeth=8, tooth_depth=0.025, petiole=0.011, stalk_width=0.0013, veins=8, vein_angle_deg=46,
        midrib=0.035, relief=1.2, fold_deg=10, curl_deg=15,
    ),
    "spruce": LeafShape(
        "needle", length=0.10, leaflets=100, cluster=1, leaflet_length=0.02, leaflet_width=0.0013,
        leaflet_angle_deg=58, taper=0.15, tip=0.2, base=0.0, petiole=0.0, stalk_width=0.0032, veins=0,
        midrib=0.0, bend=0.05, fold_deg=0, curl_deg=0,
    ),
    "birch": LeafShape(
        "simple", length=0.055, width=0.043, widest=0.27, tip=0.62, base=0.22, drip=0.08, margin="double",
        teeth=9, tooth_depth=0.13, petiole=0.02, stalk_width=0.0011, veins=6, vein_angle_deg=48,
        midrib=0.035, fold_deg=10, curl_deg=20,
    ),
}  # fmt: skip

COLORS = {
    "mahogany": LeafColors((150, 120, 70), (52, 96, 42), (96, 104, 40), (56, 92, 42)),
    "bischofia": LeafColors((140, 128, 62), (58, 108, 40), (150, 66, 40), (62, 100, 42)),
    "delonix": LeafColors((136, 178, 66), (92, 142, 52), (168, 160, 62)),
    "lagerstroemia": LeafColors((140, 122, 62), (70, 112, 46), (196, 84, 42)),
    "ailanthus": LeafColors((138, 116, 62), (78, 122, 48), (198, 172, 66)),
    "palm": LeafColors((112, 146, 58), (84, 124, 50), (84, 124, 50), (88, 122, 54), stalk=(128, 136, 70)),
    "terminalia": LeafColors((128, 164, 60), (66, 114, 42), (184, 52, 36), (150, 58, 38)),
    "pine": LeafColors((110, 146, 72), (62, 96, 56), (66, 96, 54), (60, 88, 54), stalk=(138, 100, 62)),
    "ficus virens": LeafColors((176, 120, 80), (64, 110, 44), (120, 124, 46), (66, 104, 46)),
    "willow": LeafColors((150, 178, 78), (98, 136, 60), (206, 186, 76), back=(150, 172, 140)),
    "ficus benjamina": LeafColors((112, 156, 58), (48, 98, 42), (48, 98, 42), (50, 94, 44), variation=0.2),
    "ficus microcarpa": LeafColors((116, 152, 58), (44, 90, 40), (44, 90, 40), (46, 86, 42), variation=0.2),
    "oak": LeafColors((134, 158, 66), (70, 108, 44), (168, 112, 48)),
    "beech": LeafColors((136, 180, 70), (64, 110, 46), (196, 116, 46)),
    "spruce": LeafColors((124, 166, 78), (48, 82, 50), (48, 82, 50), (46, 76, 50), stalk=(150, 108, 66)),
    "birch": LeafColors((140, 176, 72), (84, 126, 52), (222, 184, 56)),
}

BARK = {
    "mahogany": BarkShape(
        "plates", tile=0.3, count=8, stretch=2.2, weave=0.7, depth=0.006, crack=0.3, color=(122, 98, 80),
        deep=(70, 50, 40), variation=0.5,
    ),
    "bischofia": BarkShape(
        "plates", tile=0.25, count=10, stretch=1.6, weave=0.9, depth=0.004, crack=0.2, color=(124, 88, 68),
        deep=(74, 48, 38), variation=0.6,
    ),
    "delonix": BarkShape(
        "smooth", tile=0.4, depth=0.006, crack=0.5, roughness=0.6, marks=0.2, color=(142, 130, 114),
        deep=(84, 74, 64), mark=(176, 170, 154), variation=0.5,
    ),
    "lagerstroemia": BarkShape(
        "patched", tile=0.3, count=4, stretch=2.5, weave=0.6, depth=0.002, roughness=0.2,
        color=(166, 126, 92), deep=(206, 190, 164), variation=0.4,
    ),
    "ailanthus": BarkShape(
        "diamond", tile=0.3, count=5, stretch=5.0, weave=0.7, depth=0.003, crack=0.08, roughness=0.4,
        color=(138, 130, 118), deep=(172, 158, 134), variation=0.4,
    ),
    "palm": BarkShape(
        "rings", tile=0.5, count=7, weave=0.5, depth=0.012, crack=0.3, roughness=0.6, color=(140, 128, 110),
        deep=(78, 66, 54), variation=0.5,
    ),
    "terminalia": BarkShape(
        "ridged", tile=0.3, count=9, stretch=3.0, weave=0.7, depth=0.005, crack=0.25, color=(116, 104, 92),
        deep=(62, 52, 46),
    ),
    "pine": BarkShape(
        "plates", tile=0.4, count=5, stretch=1.8, weave=0.9, depth=0.014, crack=0.3, roughness=0.5,
        color=(150, 98, 66), deep=(54, 38, 32), variation=0.8,
    ),
    "ficus virens": BarkShape(
        "smooth", tile=0.4, depth=0.008, crack=0.8, roughness=0.7, marks=0.15, color=(136, 128, 116),
        deep=(82, 74, 66), mark=(112, 104, 94), variation=0.4,
    ),
    "willow": BarkShape(
        "ridged", tile=0.35, count=6, stretch=4.5, weave=0.55, depth=0.014, crack=0.55, color=(128, 116, 96),
        deep=(52, 44, 36), variation=0.5,
    ),
    "ficus benjamina": BarkShape(
        "smooth", tile=0.3, depth=0.003, crack=0.3, roughness=0.4, marks=0.1, color=(158, 150, 136),
        deep=(104, 96, 86), mark=(186, 180, 166), variation=0.3,
    ),
    "ficus microcarpa": BarkShape(
        "lenticels", tile=0.3, count=12, depth=0.003, roughness=0.4, marks=0.1, color=(140, 128, 112),
        deep=(88, 78, 68), mark=(176, 160, 138), variation=0.3,
    ),
    "oak": BarkShape(
        "ridged", tile=0.3, count=5, stretch=2.6, weave=0.9, depth=0.014, crack=0.5, roughness=0.7,
        color=(126, 114, 98), deep=(44, 36, 30), marks=0.15, mark=(138, 142, 118), variation=0.5,
    ),
    "beech": BarkShape(
        "smooth", tile=0.4, depth=0.002, crack=0.15, roughness=0.35, marks=0.25, color=(146, 144, 138),
        deep=(100, 98, 92), mark=(172, 174, 166), variation=0.3,
    ),
    "spruce": BarkShape(
        "plates", tile=0.25, count=12, stretch=1.1, weave=0.9, depth=0.005, crack=0.35, roughness=0.6,
        color=(122, 92, 74), deep=(66, 46, 38), variation=0.7,
    ),
    "birch": BarkShape(
        "lenticels", tile=0.35, count=5, depth=0.004, roughness=0.4, marks=0.45, color=(226, 222, 212),
        deep=(120, 110, 100), mark=(40, 36, 34), variation=0.3,
    ),
}  # fmt: skip
